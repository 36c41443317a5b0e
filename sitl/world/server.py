"""The running world: truth in, depth, ranges and odometry out, and a score at the end."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from companion.clock import Clock
from companion.config.settings import Settings
from companion.flight.tasks import first_of
from companion.model import Observation, Pose
from companion.pipeline import spacing
from companion.sensors.drivers.stream_server import StreamServer
from sitl.scene.fellows import Body
from sitl.scene.live import LiveWorld
from sitl.scene.render import DepthRenderer
from sitl.scene.sensors import SensorRig
from sitl.world.connection import Connection, PeerUrl
from sitl.world.contact_monitor import ContactMonitor, Look, Trajectory, write_score
from sitl.world.handshake import Handshake, send_heartbeat, told_an_origin, wanted_ids
from sitl.world.mavlink_out import Feed, LocalFrame, Outgoing, bins_of_beams, bins_of_planar
from sitl.world.neighbours import Neighbourhood, Neighbours
from sitl.world.odometry import Odometry, OdometrySettings
from sitl.world.placement import Placer, Scene
from sitl.world.trouble import commanded
from sitl.world.truth_messages import TruthKind, TruthReader

log = logging.getLogger(__name__)

CONTACT = "contact"

SEND_S = 1.0
SCORE_S = 5.0
STATUS_S = 10.0

INTERRUPTED, TERMINATED = "interrupted", "terminated"


@dataclass(frozen=True, slots=True)
class Plan:
    """What the world is asked to do; the command's options say what each means."""

    truth: PeerUrl
    stream_url: str
    system_id: int = 1
    truth_from: TruthKind = TruthKind.AUTO
    truth_hz: float = 50.0
    feed: Feed = Feed.NONE
    odometry: OdometrySettings = field(default_factory=OdometrySettings)
    odometry_to: PeerUrl | None = None
    frame: LocalFrame = LocalFrame.LOCAL_NED
    gps: bool = True
    send_distance_sensor: bool = False
    send_obstacle_distance: bool = False
    stop_on_contact: bool = False
    score: Path | None = None
    trajectory: Path | None = None
    control_port: int | None = None
    neighbourhood: Neighbourhood | None = None
    verbose: bool = False


class WorldServer:
    """One vehicle's world.

    The event loop reads the truth and feeds the odometry; a thread of its own renders, always from the newest truth, so
    a large image delays nothing but itself.

    Args:
        scene: the mine.
        settings: sensors and their noise.
        seed: draws the noise.
        plan: what to serve.
        clock: stamps everything; that of the computer, or clients on it cannot read the stamps.
        say: takes lines for people.
    """

    def __init__(
        self, scene: Scene, settings: Settings, seed: int, plan: Plan, clock: Clock, say: Callable[[str], None]
    ) -> None:
        to_sensors, to_odometry = np.random.SeedSequence((seed, plan.system_id)).spawn(2)
        self.ended_because = ""
        camera = settings.sensors.camera.model()
        body = Body(settings.vehicle.body_radius_m, settings.vehicle.body_height_m)
        live = LiveWorld(scene.world, scene.caster, camera, None if plan.neighbourhood is None else body)
        self._number = 1 if plan.neighbourhood is None else plan.neighbourhood.number
        self._neighbours = Neighbours(self._number, body, spacing(settings), live)
        self.contacts = ContactMonitor(scene, settings, live)
        self._live = live
        self._scene, self._settings, self._seed, self._plan = scene, settings, seed, plan
        self._clock, self._say = clock, say
        self._camera = camera
        renderer = DepthRenderer(scene.world, camera)
        rigs = [
            SensorRig(
                *(settings.sensors, settings.sim.noise, scene.caster, renderer, np.random.default_rng(draws), live),
                self._number,
            )
            for draws in (to_sensors, to_sensors)
        ]
        # Compiles what is compiled at first use: that takes seconds, and later it would be the first frames.
        rigs[0].observe(scene.stand)
        ContactMonitor(scene, settings, live).look(scene.stand)
        self._rig = rigs[1]
        self._reader = TruthReader(plan.truth_from)
        self._placer = Placer(scene.stand)
        self._odometry = Odometry(plan.odometry, np.random.default_rng(to_odometry))
        self._connection = Connection(plan.truth, plan.system_id, wanted_ids(plan.truth_from), clock, self._on_message)
        self._connections = [self._connection]
        if plan.odometry_to is not None:
            # Who passes odometry on also tells what the autopilot says, which is known already.
            nothing = frozenset[int]()
            self._connections.append(Connection(plan.odometry_to, plan.system_id, nothing, clock, self._on_message))
        sender, tracker = self._connection.mavlink, self._connections[-1].mavlink
        self._outgoing = Outgoing(sender, plan.feed, plan.odometry, plan.frame)
        self._tracker = Outgoing(tracker, plan.feed, plan.odometry, plan.frame)
        told = told_an_origin(plan.gps, plan.frame)
        self._handshake = Handshake(sender, plan.system_id, self._reader, plan.truth_hz, told)
        self._trajectory = Trajectory(plan.trajectory)
        self._newest: tuple[Pose, int] | None = None
        self._restarts_seen = 0
        self._fresh = asyncio.Event()
        self._stop = asyncio.Event()
        self._frames = self._readings = self._estimates = self._truths = 0
        self._last_look: Look | None = None

    async def run(self) -> None:
        """Serves until it is stopped; then, however it ended, the score is written.

        Raises:
            InputError: an address cannot be used, or a file cannot be written.
        """
        renderer = ThreadPoolExecutor(1, thread_name_prefix="render")
        try:
            with self._trajectory, signals_call(self.stop):
                async with (
                    commanded(self._plan.control_port, self._odometry.begin),
                    self._among_others(),
                    StreamServer(self._plan.stream_url, self._camera, self._clock) as server,
                ):
                    self._say(self._introduction(server))
                    ended = await first_of(
                        self._stop.wait(),
                        *(one.run() for one in self._connections),
                        self._render(renderer, server),
                        every(SEND_S, self._send_due),
                        every(SCORE_S, self._keep_score, at_once=False),
                        every(STATUS_S, lambda: self._say_status(server), at_once=False),
                    )
                    for one in ended:
                        one.result()
        except BaseException as error:
            self.ended_because = self.ended_because or f"error: {error or type(error).__name__}"
            raise
        finally:
            renderer.shutdown(wait=True)
            self._keep_score()

    def _among_others(self) -> AbstractAsyncContextManager[None]:
        neighbourhood = self._plan.neighbourhood
        return contextlib.nullcontext() if neighbourhood is None else self._neighbours.heard(neighbourhood)

    def stop(self, because: str) -> None:
        """Ends `run` in good order; the first reason counts."""
        self.ended_because = self.ended_because or because
        self._stop.set()

    def score(self) -> dict[str, object]:
        """What really happened so far."""
        scene, stand = self._scene, self._scene.stand
        return {
            "world": scene.world.name,
            "origin_m": list(scene.world.origin_m),
            "seed": self._seed,
            "system_id": self._plan.system_id,
            "ended_because": self.ended_because or None,
            "truth_from": str(self._reader.kind),
            "start": [round(value, 4) for value in (stand.x_m, stand.y_m, stand.z_m, stand.yaw_rad)],
            **self.contacts.figures(),
            **({} if self._plan.neighbourhood is None else self._neighbours.figures()),
            "simulator_restarts": self._placer.restarts,
            "truth_messages": self._truths,
            "truth_refused": self._reader.refused,
            "malformed_messages": self._connection.counts.malformed,
            "unsent_messages": sum(one.counts.unsent for one in self._connections),
            "depth_frames": self._frames,
            "range_readings": self._readings,
            "odometry": str(self._plan.feed),
            "odometry_sent": self._estimates,
            "odometry_lost": self._odometry.lost,
            "odometry_resets": self._odometry.resets,
        }

    def _on_message(self, message: Any, received_s: float) -> None:
        """One message of the autopilot, in the event loop."""
        self._handshake.on_message(message, received_s)
        ned = self._reader.on_message(message, received_s)
        if ned is None:
            return
        restarts = self._placer.restarts
        pose = self._placer.place(ned)
        if self._truths == 0 and self._handshake.armed:
            log.warning("the vehicle was armed before the world began: where it is now is taken for its start")
        self._truths += 1
        self._handshake.on_truth(received_s)
        if self._placer.restarts != restarts:
            self._odometry.restart()
            self._handshake.restart(received_s)
        self._neighbours.moved(pose)
        self._newest = (pose, self._placer.restarts)
        self._fresh.set()
        if self._plan.feed is not Feed.NONE and self._odometry.observe(pose, self._placer.heading_offset_rad()):
            delay_s = self._plan.odometry.delay_s
            if delay_s > 0.0:
                # A hair later than due, lest rounding leave it for the next.
                asyncio.get_running_loop().call_later(delay_s + 1e-4, self._send_odometry)
            else:
                self._send_odometry()

    def _send_due(self) -> None:
        self._handshake.send_due(self._clock.now_s())
        for one in self._connections[1:]:
            send_heartbeat(one.mavlink)

    def _send_odometry(self) -> None:
        for estimate in self._odometry.due(self._clock.now_s()):
            self._tracker.odometry(estimate, self._handshake.is_ardupilot)
            self._estimates += 1

    async def _render(self, renderer: ThreadPoolExecutor, server: StreamServer) -> None:
        loop = asyncio.get_running_loop()
        while True:
            await self._fresh.wait()
            self._fresh.clear()
            newest = self._newest
            if newest is None:
                continue
            observation, look = await loop.run_in_executor(renderer, self._see, *newest)
            self._publish(observation, server)
            if look is not None:
                self._last_look = look
                self._trajectory.add(look)
                if look.touching and self._plan.stop_on_contact:
                    self.stop(CONTACT)

    def _see(self, pose: Pose, restarts: int) -> tuple[Observation, Look | None]:
        """Everything that takes time, in the renderer's thread."""
        if restarts != self._restarts_seen:
            self._restarts_seen = restarts
            self.contacts.restart()
            self._live.restart()
        self._live.look(pose, self._number)
        return self._rig.observe(pose), self.contacts.look(pose)

    def _publish(self, observation: Observation, server: StreamServer) -> None:
        plan, ranges, planar = self._plan, observation.ranges, observation.planar
        if observation.frame is not None:
            self._frames += 1
            server.publish_depth(observation.frame.t_s, observation.frame.depth_m)
        if ranges:
            self._readings += len(ranges)
            server.publish_ranges(ranges)
            if plan.send_distance_sensor:
                self._outgoing.distances(ranges)
        if planar is not None:
            server.publish_planar(planar.t_s, planar.bearings_rad, planar.ranges_m, planar.max_range_m)
        if plan.send_obstacle_distance:
            # A vehicle with a scanner knows all around; without one it knows what its beams know.
            if planar is not None:
                self._outgoing.obstacles(planar.t_s, bins_of_planar(planar), planar.max_range_m)
            elif ranges and not self._settings.sensors.planar.enabled:
                self._outgoing.obstacles(ranges[0].t_s, bins_of_beams(ranges), ranges[0].max_range_m)

    def _keep_score(self) -> None:
        self._trajectory.flush()
        if self._plan.score is not None:
            write_score(self._plan.score, self.score())

    def _introduction(self, server: StreamServer) -> str:
        camera, plan = self._camera, self._plan
        feed = "no odometry" if plan.feed is Feed.NONE else f"{plan.feed} at {plan.odometry.rate_hz:g} Hz"
        to = "the autopilot" if plan.odometry_to is None else plan.odometry_to
        return (
            f"{self._scene.world.name}: depth {camera.width_px} x {camera.height_px} at "
            f"{self._settings.sensors.camera.rate_hz:g} Hz and ranges at {server.url}, {feed} to {to}; "
            f"waiting for its truth at {plan.truth}"
        )

    def _say_status(self, server: StreamServer) -> None:
        if self._plan.verbose:
            look = self._last_look
            d = "not flying" if look is None or look.d_m is None else f"d {look.d_m:.2f} m"
            rate_hz = self._handshake.truth_hz(self._clock.now_s())
            self._say(f"{self._progress()}; truth {rate_hz:.0f} Hz, {server.client_count} clients, {d}")

    def summary(self) -> str:
        """One line about what happened."""
        return f"ended: {self.ended_because}; {self._progress()}"

    def _progress(self) -> str:
        monitor = self.contacts
        least = f"least d {monitor.least_d_m:.2f} m" if math.isfinite(monitor.least_d_m) else "never flew"
        return (
            f"{monitor.time_s:.0f} s, {monitor.path_m:.1f} m flown, {least}, {monitor.contacts} contacts, "
            f"{self._frames} frames, {self._estimates} odometry"
        )


async def every(period_s: float, action: Callable[[], None], at_once: bool = True) -> None:
    """Calls ``action`` again and again until cancelled."""
    if not at_once:
        await asyncio.sleep(period_s)
    while True:
        action()
        await asyncio.sleep(period_s)


@contextlib.contextmanager
def signals_call(stop: Callable[[str], None]) -> Iterator[None]:
    """Ctrl-C and SIGTERM call ``stop`` with the reason, so that everything ends in good order."""
    loop = asyncio.get_running_loop()
    reasons = {signal.SIGINT: INTERRUPTED, signal.SIGTERM: TERMINATED}
    # Not in the main thread of a program: then whoever runs it stops it.
    with contextlib.suppress(RuntimeError, ValueError):
        for number, reason in reasons.items():
            loop.add_signal_handler(number, stop, reason)
    try:
        yield
    finally:
        for number in reasons:
            with contextlib.suppress(RuntimeError, ValueError):
                loop.remove_signal_handler(number)
