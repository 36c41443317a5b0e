"""The command `companion`.

Commands of other packages are found by name through the entry-point group `companion.commands`. They are imported only
when they are called: the help and the configuration must not wait for the libraries of a simulation.
"""

from __future__ import annotations

import ast
import importlib.util
import io
import json
import sys
from collections.abc import Sequence
from importlib.metadata import EntryPoint, entry_points, version
from pathlib import Path
from typing import Annotated

import typer

from companion.cli import flight as flight_commands
from companion.cli import keys as keys_commands
from companion.cli import safety as safety_commands
from companion.cli.ground import ground
from companion.cli.maps import commands as map_commands
from companion.cli.options import Config, Preset
from companion.errors import EXIT_INTERRUPTED, CompanionError
from companion.interruption import signals_are_ctrl_c
from companion.output import lossy_output

DISTRIBUTION = "mine-companion"
COMMANDS_GROUP = "companion.commands"


config_app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Show, check and describe the settings.")


@config_app.command()
def show(config: Config = None, preset: Preset = None) -> None:
    """Print every effective setting as commented YAML, ready to be edited."""
    from companion.config.load import load
    from companion.config.show import dump_yaml

    loaded = load(config, preset)
    file = "" if config is None else f", overridden by {str(config)!a}"
    typer.echo(f"# Effective settings: defaults, overridden by preset {loaded.preset}{file}.")
    typer.echo(f"preset: {loaded.preset}\n")
    typer.echo(dump_yaml(loaded.settings), nl=False)


@config_app.command()
def check(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="YAML file with settings.")], preset: Preset = None
) -> None:
    """Say whether a settings file can be used, and if not, everything that is wrong with it.

    And how narrow and how low a place may be that it flies through.
    """
    from companion.config.load import load
    from companion.safety_case.passages import passages
    from companion.sensors.drivers.driver import find_drivers

    loaded = load(file, preset)
    find_drivers(loaded.settings)
    typer.echo(f"{file}: OK (preset {loaded.preset})")
    typer.echo(str(passages(loaded.settings)))


@config_app.command()
def schema() -> None:
    """Print the JSON Schema of the settings file, for editors."""
    from companion.config.show import json_schema

    typer.echo(json.dumps(json_schema(), indent=2))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command and exit with its code: 0 done, 1 failed, 2 wrong input or usage, 130 interrupted.

    What the user can mend is one plain message on stderr; anything else keeps its traceback. A standard output that
    takes nothing any more keeps no command from its work; a full disk there is told, and the exit code is 1.

    Args:
        arguments: the command line without the program's name; by default that of the process.
    """
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    called = next((argument for argument in arguments if not argument.startswith("-")), None)
    commands = {command.name: command for command in entry_points(group=COMMANDS_GROUP)}
    if isinstance(sys.stdout, io.TextIOWrapper):
        # Descriptions hold Greek letters: a terminal without them shows an escape instead of failing.
        sys.stdout.reconfigure(errors="backslashreplace")
    signals_are_ctrl_c()
    with lossy_output() as lost:
        code = _exit_code(arguments, called, commands)
    # Who wanted the output does not have it; what the command did besides is done.
    sys.exit(CompanionError.exit_code if not code and lost() is not None else code)


def _exit_code(arguments: list[str], called: str | None, commands: dict[str, EntryPoint]) -> str | int | None:
    try:
        _app(commands, called)(args=arguments, prog_name="companion")
    except CompanionError as error:
        typer.echo(str(error), err=True)
        return error.exit_code
    except ModuleNotFoundError as error:
        if called not in commands or not _is_foreign(error, commands[called]):
            raise
        typer.echo(_missing(commands[called], error), err=True)
        return CompanionError.exit_code
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except SystemExit as ended:
        return ended.code
    return 0


def _app(commands: dict[str, EntryPoint], called: str | None) -> typer.Typer:
    """The whole application; of the commands from elsewhere only the called one is imported."""
    app = typer.Typer(
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,  # help and errors stay plain text, in a terminal and in a log
    )
    app.callback()(_root)
    for command in (flight_commands.run, flight_commands.check, flight_commands.figures, flight_commands.replay):
        app.command()(command)
    app.command()(ground)
    app.add_typer(config_app, name="config")
    app.add_typer(safety_commands.app, name="safety")
    app.add_typer(map_commands.app, name="map")
    app.add_typer(keys_commands.app, name="keys")
    for name, entry in sorted(commands.items()):
        if name == called:
            loaded = entry.load()
            if isinstance(loaded, typer.Typer):
                app.add_typer(loaded, name=name)
            else:
                app.command(name)(loaded)
        else:
            app.command(name, help=_summary(entry))(_not_imported)
    return app


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(version(DISTRIBUTION))
        raise typer.Exit


def _root(
    _version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """Explore a mine with a drone and bring home a 3D map."""


def _not_imported() -> None:
    """Stands in the help for a command that was not called."""


def _summary(command: EntryPoint) -> str:
    """First paragraph of a command's docstring, read from its source: importing it may take seconds, or fail.

    For a group of commands it is that of its module.
    """
    try:
        spec = importlib.util.find_spec(command.module)
        source = Path(spec.origin).read_text(encoding="utf-8") if spec is not None and spec.origin else ""
        body = ast.parse(source).body
    except (ImportError, OSError, SyntaxError):
        return ""
    for node in body:
        if isinstance(node, ast.FunctionDef) and node.name == command.attr:
            return (ast.get_docstring(node) or "").partition("\n\n")[0]
    return (ast.get_docstring(ast.Module(body, [])) or "").partition("\n\n")[0]


def _is_foreign(error: ModuleNotFoundError, command: EntryPoint) -> bool:
    """Whether the missing module comes from elsewhere: a missing one of ours is a bug and keeps its traceback."""
    missing = (error.name or "").partition(".")[0]
    return missing not in ("", "companion", command.module.partition(".")[0])


def _missing(command: EntryPoint, error: ModuleNotFoundError) -> str:
    """What to install: a command's entry point names the extras that it needs."""
    distribution = command.dist
    if distribution is not None and command.extras:
        needed = f"'{distribution.name}[{','.join(command.extras)}]'"
    else:
        needed = f"the package that has the module {error.name}"
    return f"companion {command.name}: the module {error.name} is not installed; it needs pip install {needed}"
