"""The gate as a process: everything is opened, the application started, and messages carried until it has ended.

An exception that nobody foresaw ends the process at once. The wire is silent then, and the autopilot does what
pre-flight has checked that it does in silence: better than to fly on in a state that nobody knows.
"""

from __future__ import annotations

import contextlib
import gc
import os
import time
import traceback

from companion.errors import CompanionError, InputError
from companion.gate.gate import Gate
from companion.gate.plan import Attached, Plan, Signing
from companion.gate.runtime.framing import Accept
from companion.gate.runtime.log import Log
from companion.gate.runtime.loop import Loop
from companion.gate.runtime.processes import adopt_orphans, take_precedence
from companion.gate.runtime.signals import Signals
from companion.gate.runtime.supervisor import Supervisor
from companion.gate.runtime.systemd import ServiceManager
from companion.gate.runtime.transports import Transport, open_transport
from companion.mavlink.codec import Frame
from companion.mavlink.signing import Signer, load_key

LAST_WORDS_S = 0.5
EXIT_BROKEN = os.EX_SOFTWARE


def run(plan: Plan) -> int:
    """Be the gate until the application has ended; gives the exit code of this process.

    Raises:
        InputError: an address or the key of the signature cannot be used; nothing was started.
        CompanionError: the application cannot be started.
    """
    with contextlib.ExitStack() as stack:
        signals = Signals()
        stack.callback(signals.close)
        log = Log()
        stack.callback(log.close, LAST_WORDS_S)
        notifier = ServiceManager(os.environ)
        stack.callback(notifier.close)
        signer = None if plan.signing is None else _signer(plan.signing)
        autopilot = open_transport(plan.autopilot_url, plan.system_id, None if signer is None else _accepting(signer))
        stack.callback(autopilot.close)
        attached: list[tuple[Attached, Transport]] = []
        for one in plan.attached:
            attached.append((one, open_transport(one.url)))
            stack.callback(attached[-1][1].close)
        adopt_orphans()
        gate = Gate(plan, time.monotonic())
        supervisor = Supervisor(plan, gate, log)
        stack.callback(supervisor.close)
        try:
            supervisor.start()
        except OSError as error:
            raise CompanionError(f"the application cannot be started: {' '.join(plan.command)}: {error}") from error
        log.say(f"the autopilot is at {plan.autopilot_url}; {take_precedence() if plan.realtime else 'not real time'}")
        loop = Loop(plan, gate, supervisor, autopilot, signer, attached, signals, notifier, log, time.monotonic)
        gc.collect()
        gc.freeze()
        try:
            code = loop.run()
        except Exception:  # noqa: BLE001 - whatever it was: silence is what the autopilot understands
            log.say(f"the gate is broken and ends; the autopilot's failsafe acts\n{traceback.format_exc()}")
            return EXIT_BROKEN
        notifier.stopping()
        loop.close()
        return code


def _signer(signing: Signing) -> Signer:
    try:
        return Signer(load_key(signing.key_file), signing.link_id, time.time)
    except (OSError, ValueError) as error:
        raise InputError(f"safety.signing.key_file {signing.key_file}: {error}") from error


def _accepting(signer: Signer) -> Accept:
    """What comes from the autopilot: rightly signed, and passed on without the signature."""

    def accept(frame: Frame) -> Frame | None:
        if not signer.accepts(frame.raw):
            return None
        if not frame.signed:
            return frame
        plain = signer.unsigned(frame.raw)
        return Frame(plain, frame.message_id, frame.system_id, frame.component_id, frame.payload, False)

    return accept
