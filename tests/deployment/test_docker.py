"""The images and compose files in docker/, as far as they can be checked without building them."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import socket
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from fnmatch import fnmatch
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import jsonschema
import pytest
import yaml
from packaging.markers import Marker
from packaging.tags import Tag, compatible_tags, cpython_tags
from packaging.utils import parse_wheel_filename

from companion.config.load import load_settings
from companion.config.show import dump_yaml
from sitl.world.connection import PeerUrl

ROOT = Path(__file__).parents[2]
DOCKER = ROOT / "docker"
COMPOSE_FILES = sorted(DOCKER.glob("compose.*.yaml"))
COMPANION = Path(sys.executable).with_name("companion")
OURS = ("mine-companion", "mine-companion-sim")

compose_file = pytest.mark.parametrize("file", COMPOSE_FILES, ids=lambda file: file.name)


def load_reader() -> Any:
    """docker/check/dockerfile.py: docker/ is no package, and must not be taken for the one of that name."""
    spec = importlib.util.spec_from_file_location("dockerfile_reader", DOCKER / "check" / "dockerfile.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their own module up
    spec.loader.exec_module(module)
    return module


READER = load_reader()
DOCKERFILE = READER.read(DOCKER / "Dockerfile")


def interpolated(text: str) -> str:
    """With the default of each ``${NAME:-default}``, as when nobody has chosen anything."""
    return re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", text)


def load_compose(file: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = yaml.safe_load(interpolated(file.read_text(encoding="utf-8")))
    return loaded


def services(file: Path) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = load_compose(file)["services"]
    return found


def option(service: dict[str, Any], name: str) -> list[str]:
    """The values of ``--name=value`` in a service's command."""
    return [word.partition("=")[2] for word in service["command"] if word.startswith(f"--{name}=")]


def port(address: str) -> int:
    return int(address.rpartition(":")[2])


@cache
def help_of(*command: str) -> str:
    """What ``companion ... --help`` prints; wide, so that no option is cut."""
    environment = {**os.environ, "COLUMNS": "200", "TERM": "dumb"}
    asked = [str(COMPANION), *command, "--help"]
    done = subprocess.run(asked, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, f"companion {' '.join(command)} --help: {done.stderr[-500:]}"
    return str(done.stdout)


def registered(command: str) -> bool:
    return re.search(rf"^  {command}\b", help_of(), re.MULTILINE) is not None


def called(file: Path) -> Iterator[tuple[tuple[str, ...], list[str]]]:
    """Each command of ours in a compose file: its name, which may have two words, and its options."""
    for service in services(file).values():
        if service["image"] in OURS:
            words: list[str] = service["command"]
            name = tuple(words[:2]) if words[0] == "sitl" else (words[0],)
            yield name, [word.partition("=")[0] for word in words if word.startswith("--")]


class TestComposeFiles:
    """One command brings up autopilot, world and application, and they find each other."""

    def test_there_is_one_for_each_autopilot(self) -> None:
        assert [file.name for file in COMPOSE_FILES] == [
            "compose.ardupilot.yaml",
            "compose.px4.yaml",
            "compose.stub.yaml",
        ]

    @compose_file
    def test_fit_the_schema_of_compose_files(self, file: Path) -> None:
        schema = json.loads((DOCKER / "check" / "compose-spec.json").read_text(encoding="utf-8"))
        jsonschema.Draft7Validator(schema).validate(load_compose(file))

    @compose_file
    def test_bring_up_autopilot_world_and_application_in_one_network(self, file: Path) -> None:
        found = services(file)
        assert set(found) == {"autopilot", "world", "application"}
        assert "network_mode" not in found["autopilot"]
        for name in ("world", "application"):
            assert found[name]["network_mode"] == "service:autopilot"
        assert found["application"]["depends_on"] == {"world": {"condition": "service_healthy"}}

    @compose_file
    def test_build_stages_that_exist(self, file: Path) -> None:
        for service in services(file).values():
            build = service.get("build")
            if build is None:
                assert not service["image"].startswith(OURS[0]), "an image of ours that nobody builds"
                continue
            assert (file.parent / build["context"]).resolve() == ROOT
            assert (ROOT / build["dockerfile"]).is_file()
            assert build["target"] in DOCKERFILE.stages

    @compose_file
    def test_confine_every_service(self, file: Path) -> None:
        for name, service in services(file).items():
            assert service["read_only"] is True, name
            assert service["cap_drop"] == ["ALL"], name
            assert service["security_opt"] == ["no-new-privileges:true"], name
            assert service["restart"] == "no", f"{name}: after a restart, a person starts the flight"
            assert {"mem_limit", "cpus", "pids_limit", "tmpfs", "logging"} <= set(service), name
            assert not {"privileged", "cap_add", "devices", "ports", "user"} & set(service), name
            assert service.get("network_mode") != "host", name

    @compose_file
    def test_images_of_others_are_pinned(self, file: Path) -> None:
        for service in services(file).values():
            if "build" not in service:
                tag = service["image"].partition(":")[2]
                assert re.search(r"\d", tag), f"{service['image']} is no certain version"

    @compose_file
    def test_commands_exist_with_their_options(self, file: Path) -> None:
        for name, options in called(file):
            if not registered(name[0]):
                pytest.skip(f"companion {name[0]} is not there yet")
            shown = help_of(*name)
            for wanted in options:
                assert re.search(rf"{wanted}\b", shown), f"companion {' '.join(name)} has no {wanted}"

    @compose_file
    def test_addresses_fit_the_settings_of_the_application(self, file: Path) -> None:
        found = services(file)
        (mounted,) = (v for v in found["application"]["volumes"] if v.endswith("/etc/companion/vehicle.yaml:ro"))
        settings = load_settings(file.parent / mounted.partition(":")[0])
        link, stream = urlsplit(settings.autopilot.url), urlsplit(settings.sensors.stream.url)
        assert (link.scheme, stream.hostname) == ("udpin", "127.0.0.1")
        assert found["application"]["healthcheck"]["test"] == ["CMD", "healthcheck", "udp", str(link.port)]
        assert found["world"]["healthcheck"]["test"] == ["CMD", "healthcheck", "tcp", str(stream.port)]
        assert f"{settings.record.folder}" in [v.partition(":")[2] for v in found["application"]["volumes"]]
        (truth,) = option(found["world"], "truth")
        assert PeerUrl.of_truth(truth).kind == "udp", "the autopilot sends, the world listens"
        assert "--start=now" in found["application"]["command"], "there is nobody to press a key"

    @pytest.mark.parametrize("personality", ["px4", "ardupilot"])
    def test_every_simulated_autopilot_is_flown_as_it_is_by_default(self, personality: str) -> None:
        """One default brakes with both: settings of its own would be a second truth."""
        assert load_settings(DOCKER / f"simulated.{personality}.yaml").control == load_settings().control

    def test_the_stub_sends_to_application_and_world(self) -> None:
        found = services(DOCKER / "compose.stub.yaml")
        to = [port(address) for address in option(found["autopilot"], "to")]
        assert to == [urlsplit(load_settings().autopilot.url).port, *map(port, option(found["world"], "truth")), 14550]

    def test_ardupilot_sends_to_application_and_world(self) -> None:
        found = services(DOCKER / "compose.ardupilot.yaml")
        to = [port(option(found["autopilot"], f"serial{i}")[0]) for i in range(3)]
        assert to == [urlsplit(load_settings().autopilot.url).port, 14550, *map(port, option(found["world"], "truth"))]

    def test_px4_simulates_its_vehicle_itself_and_the_world_listens_to_its_truth(self) -> None:
        found = services(DOCKER / "compose.px4.yaml")
        assert found["autopilot"]["environment"]["PX4_SIM_MODEL"] == "sihsim_quadx"
        # PX4's end of the companion's link, as the kernel writes port numbers.
        assert f":{14580:04X} " in found["autopilot"]["healthcheck"]["test"][1]
        assert [port(url) for url in option(found["world"], "truth")] == [19410]

    @compose_file
    def test_pre_flight_sets_what_the_autopilot_does_in_silence(self, file: Path) -> None:
        """Simulators come with their defaults, with which pre-flight refuses to fly."""
        assert "--fix" in services(file)["application"]["command"]

    def test_the_stub_stands_where_the_world_is_shown(self) -> None:
        found = services(DOCKER / "compose.stub.yaml")
        for name in ("world", "seed"):
            assert option(found["autopilot"], name) == option(found["world"], name) != []
        assert found["autopilot"]["healthcheck"]["test"][-1:] == option(found["autopilot"], "bind-port")


class TestDockerfile:
    """The images are made of the locked packages, run without rights, and need not compile on the vehicle."""

    @pytest.mark.parametrize("target", ["vehicle", "sim", "ardupilot"])
    def test_images_run_without_rights(self, target: str) -> None:
        users = [i.text for stage in DOCKERFILE.lineage(target) for i in stage.instructions if i.name == "USER"]
        assert users
        assert users[-1] not in ("root", "0")

    def test_stages_begin_with_pinned_images(self) -> None:
        for stage in DOCKERFILE.stages.values():
            if stage.base not in DOCKERFILE.stages:
                name, _, tag = stage.base.partition(":")
                assert name in ("python", "debian")
                assert tag.endswith("-slim-bookworm") or tag == "bookworm-slim"

    def test_python_is_the_one_that_camera_wheels_for_arm_exist_for(self) -> None:
        assert DOCKERFILE.arguments["PYTHON_IMAGE"].startswith("python:3.12.")

    @pytest.mark.parametrize(("target", "extras"), [("vehicle-build", []), ("sim-build", ["sim"])])
    def test_packages_are_the_locked_ones(self, target: str, extras: list[str]) -> None:
        syncs = [i.text for i in DOCKERFILE.stages[target].instructions if "uv sync" in i.text]
        assert syncs
        for sync in syncs:
            assert {"--locked", "--no-dev", "--no-editable"} <= set(sync.split())
            assert re.findall(r"--extra (\S+)", sync) == extras

    def test_uv_is_the_one_of_the_set_up(self) -> None:
        version = re.search(r"uv_version=(\S+)", (ROOT / "scripts" / "setup").read_text(encoding="utf-8"))
        assert version is not None
        installs = [i.text for i in DOCKERFILE.stages["vehicle-build"].instructions if "pip install" in i.text]
        assert [text.split()[-1] for text in installs] == [f"uv=={version[1]}"]

    def test_open3d_finds_the_libraries_of_the_set_up(self) -> None:
        in_setup = re.findall(r'^    "lib\S+": "(\S+)",', (ROOT / "scripts" / "setup").read_text("utf-8"), re.MULTILINE)
        assert sorted(DOCKERFILE.arguments["OPEN3D_LIBRARIES"].split()) == sorted(in_setup)

    def test_the_vehicle_has_no_simulation_in_it(self) -> None:
        texts = [i.text for stage in DOCKERFILE.lineage("vehicle") for i in stage.instructions]
        copied = [i for i in DOCKERFILE.stages["vehicle"].instructions if i.name == "COPY"]
        assert [(i.text, i.flags) for i in copied] == [("/opt/companion /opt/companion", (("from", "vehicle-build"),))]
        assert not any("apt-get" in text for text in texts)

    def test_what_is_copied_exists_and_is_not_ignored(self) -> None:
        for stage in DOCKERFILE.stages.values():
            for instruction in stage.instructions:
                if instruction.name == "COPY" and "from" not in dict(instruction.flags):
                    for source in instruction.words()[:-1]:
                        assert (ROOT / source).exists(), source
                        assert not ignored(source), source

    @pytest.mark.parametrize("target", ["vehicle", "sim"])
    def test_entrypoint_is_copied_and_its_command_exists(self, target: str) -> None:
        by_name = {i.name: i for stage in DOCKERFILE.lineage(target) for i in stage.instructions}
        assert by_name["ENTRYPOINT"].words() == ["entrypoint", "companion"]
        command = by_name["CMD"].words()
        if not registered(command[0]):
            pytest.skip(f"companion {command[0]} is not there yet")
        assert help_of(command[0])

    def test_what_was_compiled_in_the_build_counts_on_another_processor(self) -> None:
        """Numba takes nothing from its cache that was compiled for a processor of another name."""
        environment: dict[str, str] = {}
        for instruction in DOCKERFILE.stages["base"].instructions:
            if instruction.name == "ENV":
                environment |= READER.assignments(instruction.text)
        assert environment["NUMBA_CPU_NAME"] == "generic"
        assert environment["NUMBA_CACHE_DIR"].startswith("/tmp/"), "the only place that is writable"  # noqa: S108


def ignored(path: str) -> bool:
    """Whether .dockerignore keeps a path out of a build: the last line that fits it, or a folder above it, decides."""
    verdict = False
    parents = [path, *(str(parent) for parent in Path(path).parents if str(parent) != ".")]
    for line in (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines():
        if not line or line.startswith("#"):
            continue
        pattern = line.removeprefix("!")
        names = [Path(parent).name for parent in parents] if pattern.startswith("**/") else parents
        single = "/" not in pattern.removeprefix("**/")
        if any(fnmatch(n, pattern.removeprefix("**/")) for n in names if not (single and "/" in n)):
            verdict = not line.startswith("!")
    return verdict


UNSEEN = (
    ".git/config",
    ".venv/bin/python",
    "companion/__pycache__/cli.cpython-311.pyc",
    "docker/check/replay.py",
    "flights/x",
    "runs/x/map.ply",
    "sitl/__pycache__/render.x.nbc",
    "tests/deployment/test_docker.py",
    "vehicle.yaml",
)


@pytest.mark.parametrize("path", UNSEEN)
def test_builds_do_not_see(path: str) -> None:
    assert ignored(path)


@pytest.mark.parametrize("path", ["companion/cli/main.py", "sitl/mines/plan.py", "uv.lock", "docker/settle"])
def test_builds_see(path: str) -> None:
    assert not ignored(path)


def vehicle_packages(machine: str) -> dict[str, dict[str, Any]]:
    """What uv installs for the vehicle, by name, from uv.lock."""
    environment = {"platform_machine": machine, "sys_platform": "linux", "platform_system": "Linux", "os_name": "posix"}
    environment |= {"python_version": "3.12", "python_full_version": "3.12.11"}
    environment |= {"implementation_name": "cpython", "platform_python_implementation": "CPython", "extra": ""}
    locked: dict[str, list[dict[str, Any]]] = {}
    for package in tomllib.loads((ROOT / "uv.lock").read_text(encoding="utf-8"))["package"]:
        locked.setdefault(package["name"], []).append(package)
    found: dict[str, dict[str, Any]] = {}
    waiting: list[dict[str, Any]] = [{"name": "mine-companion"}]
    seen: list[dict[str, Any]] = []
    while waiting:
        wanted = waiting.pop()
        if wanted in seen or ("marker" in wanted and not Marker(wanted["marker"]).evaluate(environment)):
            continue
        seen.append(wanted)
        # Where there are several versions, uv says at the dependency which one.
        (package,) = (p for p in locked[wanted["name"]] if wanted.get("version") in (None, p["version"]))
        found[wanted["name"]] = package
        waiting += package.get("dependencies", [])
        for extra in wanted.get("extra", ()):
            waiting += package["optional-dependencies"][extra]
    del found["mine-companion"]
    return found


@pytest.mark.parametrize("machine", ["x86_64", "aarch64"])
def test_the_vehicle_needs_no_compiler_on_either_architecture(machine: str) -> None:
    """Every locked package has a wheel for CPython 3.12 and the C library of Debian 12, so that both images build."""
    platforms = [f"manylinux_2_{minor}_{machine}" for minor in range(36, 16, -1)]
    platforms += [f"manylinux2014_{machine}", f"manylinux2010_{machine}", f"linux_{machine}"]
    fitting: set[Tag] = {*cpython_tags((3, 12), platforms=platforms), *compatible_tags((3, 12), platforms=platforms)}
    packages = vehicle_packages(machine)
    assert {"numba", "mavsdk", "pydantic-core", "lazrs"} <= set(packages)
    assert "open3d" not in packages
    for name, package in packages.items():
        files = [wheel["url"].rpartition("/")[2] for wheel in package.get("wheels", [])]
        assert any(parse_wheel_filename(file)[3] & fitting for file in files), f"{name}: {files}"


class TestScripts:
    """The programs that the images bring along do what the compose files count on."""

    @pytest.mark.parametrize(
        "script", ["docker/entrypoint", "docker/healthcheck", "docker/settle", "scripts/check-docker"]
    )
    def test_are_executable_and_parse(self, script: str) -> None:
        shell = (ROOT / script).read_text(encoding="utf-8").splitlines()[0].rpartition("/")[2].split()[-1]
        assert os.access(ROOT / script, os.X_OK)
        subprocess.run([shell, "-n", ROOT / script], check=True)

    def test_entrypoint_becomes_the_command(self, tmp_path: Path) -> None:
        """Signals and the exit code are those of the application, not of a shell around it."""
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "numba")}
        command = [str(DOCKER / "entrypoint"), "sh", "-c", "echo $$; exit 7"]
        with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
            output, _ = process.communicate(timeout=20)
            assert int(output) == process.pid
        assert process.returncode == 7

    @pytest.mark.parametrize(("kind", "name"), [(socket.SOCK_STREAM, "tcp"), (socket.SOCK_DGRAM, "udp")])
    @pytest.mark.parametrize("family", [socket.AF_INET, socket.AF_INET6])
    def test_healthcheck_sees_who_listens(
        self, kind: socket.SocketKind, name: str, family: socket.AddressFamily
    ) -> None:
        with socket.socket(family, kind) as listener:
            try:
                listener.bind(("::1" if family == socket.AF_INET6 else "127.0.0.1", 0))
            except OSError:
                pytest.skip("this machine has no such network")
            number = str(listener.getsockname()[1])
            other = "udp" if name == "tcp" else "tcp"
            if kind == socket.SOCK_STREAM:
                assert self.health(name, number) == 1, "bound is not listening"
                listener.listen()
            assert self.health(name, number) == 0
            assert self.health(other, number) == 1
        assert self.health(name, number) == 1

    def test_healthcheck_refuses_what_it_does_not_know(self) -> None:
        assert self.health("sctp", "14540") == 2

    @staticmethod
    def health(kind: str, number: str) -> int:
        return subprocess.run([DOCKER / "healthcheck", kind, number], check=False).returncode

    def test_the_warm_up_needs_nothing_of_the_simulation(self) -> None:
        """It runs in the vehicle's image, which has no Open3D."""
        imported = re.findall(
            r"^(?:from|import) (\w+)", (ROOT / "companion" / "flight" / "warm_up.py").read_text("utf-8"), re.MULTILINE
        )
        assert "companion" in imported
        assert not {"sitl", "open3d", "matplotlib"} & set(imported)


class TestService:
    """The systemd unit refuses to run an application that would fly by itself after a restart."""

    @staticmethod
    def pattern() -> str:
        unit = (DOCKER / "companion.service").read_text(encoding="utf-8")
        found = re.search(r'^ExecStartPre=.*\| grep -q "(.*)"\'$', unit, re.MULTILINE)
        assert found is not None
        return found[1].replace('\\\\"', '"')

    @pytest.mark.parametrize(("start", "refused"), [("now", True), ("key", False), ("command", False)])
    def test_refuses_a_start_without_a_person(self, tmp_path: Path, start: str, refused: bool) -> None:
        file = tmp_path / "vehicle.yaml"
        file.write_text(f"mission: {{start: {start}}}", encoding="utf-8")
        shown = dump_yaml(load_settings(file))
        assert (re.search(self.pattern(), shown, re.MULTILINE) is not None) is refused

    def test_the_example_waits_for_the_ground_station(self) -> None:
        settings = load_settings(DOCKER / "vehicle.example.yaml")
        assert settings.mission.start == "command"
        assert settings.autopilot.url.startswith("serial://")

    def test_names_commands_that_exist(self) -> None:
        unit = (DOCKER / "companion.service").read_text(encoding="utf-8")
        commands = re.findall(r"/opt/companion/bin/companion (\w+)", unit)
        assert set(commands) == {"config", "run"}
        for command in commands:
            if not registered(command):
                pytest.skip(f"companion {command} is not there yet")
            assert help_of(command)


def test_the_estimator_of_px4s_simulator_is_told_the_noise_that_its_sensors_have() -> None:
    """With PX4's own values its velocity was wrong by up to 0.7 m/s, and zero velocity flew into walls."""
    compose = yaml.safe_load((DOCKER / "compose.px4.yaml").read_text(encoding="utf-8"))
    environment = compose["services"]["autopilot"]["environment"]
    told = {name: float(value) for name, value in environment.items() if name.startswith("PX4_PARAM_")}
    assert told == {"PX4_PARAM_EKF2_ACC_NOISE": 1.0, "PX4_PARAM_EKF2_GYR_NOISE": 0.1}


def test_the_battery_of_ardupilots_simulator_lasts_for_a_flight() -> None:
    """SITL draws 28 A, and percent is a count of what has flowed: with 3300 mAh a flight ended after 5 minutes."""
    lines = (DOCKER / "ardupilot.parm").read_text(encoding="utf-8").splitlines()
    parameters = dict(line.split() for line in lines if not line.startswith("#"))
    mission = load_settings(DOCKER / "simulated.ardupilot.yaml").mission
    used_mah = 28_000.0 * mission.time_limit_s / 3600.0
    left_percent = 100.0 * (1.0 - used_mah / float(parameters["BATT_CAPACITY"]))
    assert left_percent > mission.battery_low_percent + 10.0
