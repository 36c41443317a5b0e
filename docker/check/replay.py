"""Do what a build of docker/Dockerfile would do, without Docker, in folders that hold a plain Debian.

Called by `scripts/check-docker --run` as root, with a folder made by debootstrap that has Python 3.12 in /usr/local:

    replay.py BASE WORK vehicle|sim

For each stage a copy of its base is made in WORK, and its instructions are carried out in it: RUN by chroot with just
the variables that ENV has set. Then the entrypoint runs as the image's user with a read-only root and its own /tmp, and
it is checked that nothing is compiled any more.

What differs from Docker: Debian and Python do not come from the images that the Dockerfile names; caches are not kept;
all runs share the network of this machine, and its certificates.
"""

from __future__ import annotations

import ast
import logging
import shutil
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import dockerfile

ROOT = Path(__file__).resolve().parents[2]
NOT_IN_CONTEXT = shutil.ignore_patterns("__pycache__", "*.pyc", "*.nbc", "*.nbi")
CERTIFICATES = "/etc/ssl/certs/ca-certificates.crt"
DEFAULT_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"

log = logging.getLogger("replay")


class ReplayError(Exception):
    """An instruction failed, or the image is not as it should be."""


class Image:
    """A root folder, and what the instructions so far have said about it."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.environment = {"PATH": DEFAULT_PATH, "HOME": "/root"}
        self.user = "root"
        self.folder = "/"
        self.entrypoint: list[str] = []
        self.command: list[str] = []

    def copy_to(self, root: Path) -> Image:
        """The image that a stage FROM this one begins with."""
        if root.exists():
            shutil.rmtree(root)
        subprocess.run(["cp", "-a", "--reflink=auto", self.root, root], check=True)  # noqa: S603, S607
        image = Image(root)
        image.environment = dict(self.environment)
        image.user, image.folder = self.user, self.folder
        return image

    def inside(self, path: str) -> Path:
        """Where a path of the image is out here."""
        return self.root / (Path(self.folder) / path).relative_to("/")

    def run(self, arguments: list[str], *, read_only: bool = False) -> tuple[int, str]:
        """Exit code and output of a program in the image. Mounts are this process's own and end with it."""
        mounts = [
            "set -eu",
            'mount --bind "$0" "$0"; cd "$0"',
            "mount -t proc proc proc; mount --rbind /dev dev",
            *(["mount -o remount,bind,ro .", "mount -t tmpfs -o mode=1777 tmpfs tmp"] if read_only else []),
            'user="$1"; folder="$2"; shift 2',
            'exec chroot --userspec="$user:$user" . /usr/bin/env --chdir="$folder" -i "$@"',
        ]
        values = {"SSL_CERT_FILE": CERTIFICATES, "PIP_CERT": CERTIFICATES} | self.environment
        command = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "sh", "-c", "\n".join(mounts), self.root]
        command += [self.user, self.folder, *(f"{name}={value}" for name, value in values.items()), *arguments]
        done = subprocess.run(  # noqa: S603
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        return done.returncode, done.stdout


class Replay:
    """Builds stages of a Dockerfile, each once."""

    def __init__(self, base: Path, work: Path) -> None:
        self._file = dockerfile.read(ROOT / "docker" / "Dockerfile")
        self._base = Image(base)
        self._work = work
        self._done: dict[str, Image] = {}

    def stage(self, name: str) -> Image:
        """The image of a stage."""
        if name not in self._done:
            stage = self._file.stages[name]
            below = self.stage(stage.base) if stage.base in self._file.stages else self._base
            image = below.copy_to(self._work / f"stage-{name}")
            arguments: dict[str, str] = {}
            for instruction in stage.instructions:
                log.info("%s: %s %s", name, instruction.name, instruction.text[:100])
                self._carry_out(image, instruction, arguments)
            self._done[name] = image
        return self._done[name]

    def _carry_out(self, image: Image, instruction: dockerfile.Instruction, arguments: dict[str, str]) -> None:
        text = instruction.text
        match instruction.name:
            case "ARG":
                arguments[text] = self._file.arguments[text]
            case "ENV":
                image.environment |= dockerfile.assignments(text)
            case "USER":
                image.user = text
            case "WORKDIR":
                image.folder = text
                image.inside(".").mkdir(parents=True, exist_ok=True)
            case "ENTRYPOINT":
                image.entrypoint = instruction.words()
            case "CMD":
                image.command = instruction.words()
            case "COPY":
                self._copy(image, instruction)
            case "RUN":
                for flag, value in instruction.flags:
                    options = dict(option.split("=") for option in value.split(","))
                    if flag != "mount" or options["type"] != "cache":
                        raise ReplayError(f"line {instruction.line}: --{flag}={value} is not known here")
                    image.inside(options["target"]).mkdir(parents=True, exist_ok=True)
                values = [f"{name}={value}" for name, value in arguments.items()]
                code, output = image.run(["env", *values, "sh", "-c", text])
                if code != 0:
                    raise ReplayError(f"line {instruction.line}: RUN ended with {code}:\n{output}")
            case "STOPSIGNAL":
                pass
            case other:
                raise ReplayError(f"line {instruction.line}: {other} is not known here")

    def _copy(self, image: Image, instruction: dockerfile.Instruction) -> None:
        flags = dict(instruction.flags)
        *sources, target = instruction.words()
        origin = self.stage(flags["from"]).root if "from" in flags else ROOT
        for source in sources:
            place = image.inside(target)
            if target.endswith("/"):
                place /= Path(source).name
            place.parent.mkdir(parents=True, exist_ok=True)
            found = origin / source.lstrip("/")
            if "from" in flags:
                subprocess.run(["cp", "-a", found, place], check=True)  # noqa: S603, S607
            elif found.is_dir():
                shutil.copytree(found, place, ignore=NOT_IN_CONTEXT, dirs_exist_ok=True)
            else:
                shutil.copy2(found, place)
            if "chmod" in flags:
                place.chmod(int(flags["chmod"], 8))


def compiled_names(package: Path) -> set[str]:
    """``module.function`` of every function that numba compiles in a package."""
    return {
        f"{file.stem}.{node.name}"
        for file in package.rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef)
        and any(ast.unparse(decorator).startswith("compiled") for decorator in node.decorator_list)
    }


def check_cache(image: Image) -> None:
    """Every compiled function is in the image's cache, and the user of the image compiles nothing anew."""
    cache = image.root / "opt/companion/numba"
    cached = {file.name.rsplit("-", 1)[0] for file in cache.rglob("*.nbi")}
    left_out = compiled_names(ROOT / "companion") - cached
    if left_out:
        raise ReplayError(f"companion/flight/warm_up.py leaves out {', '.join(sorted(left_out))}")
    count = 'find "$NUMBA_CACHE_DIR" -name "*.nbc" | wc -l'
    again = "python -m companion.flight.warm_up"
    script = f"before=$({count}); {again} || exit; after=$({count}); echo $before $after; [ $before -eq $after ]"
    code, output = image.run(
        [image.entrypoint[0], "sh", "-c", script],
        read_only=True,
    )
    if code != 0:
        raise ReplayError(f"the image compiles anew what should be in its cache: {output}")
    log.info("compiled functions in the cache, before and after a flight: %s", output.strip())


def check_commands(image: Image, calls: list[list[str]]) -> None:
    """The entrypoint starts each command, as the image's user and without writing outside of /tmp."""
    for call in calls:
        code, output = image.run([*image.entrypoint, *call], read_only=True)
        if code != 0:
            raise ReplayError(f"{' '.join(call)} ended with {code}:\n{output}")
        log.info("%s: %s", " ".join(call), output.strip().splitlines()[0] if output.strip() else "(silent)")


def main() -> int:
    """Replay one target; the exit code."""
    base, work, target = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
    logging.basicConfig(level=logging.INFO, format="%(relativeCreated)7d ms  %(message)s")
    calls = [["--version"], ["config", "show"]]
    calls += (
        [["run", "--help"]] if target == "vehicle" else [["sitl", name, "--help"] for name in ("autopilot", "world")]
    )
    try:
        image = Replay(base, work).stage(target)
        if image.user == "root":
            raise ReplayError(f"{target} runs as root")
        check_commands(image, calls)
        check_cache(image)
    except (ReplayError, dockerfile.DockerfileError) as error:
        log.error("FAILED: %s", error)
        return 1
    log.info("%s: ok", target)
    return 0


if __name__ == "__main__":
    sys.exit(main())
