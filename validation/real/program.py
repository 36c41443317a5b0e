"""What the programs of this folder share: options, the network that they need, results that are whole."""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

from companion.errors import InputError
from validation.fault_matrix.injection import PERSONALITIES
from validation.fault_matrix.run import end_with_parent
from validation.real.flight import Ways

OWN_NETWORK = "OWN_NETWORK"
"""Set by scripts/own-network."""


def common(parser: argparse.ArgumentParser) -> None:
    """The options of programs that fly the application."""
    flights(parser)
    parser.add_argument("--skip", nargs="+", default=[], metavar="CHECK", help="pre-flight skips these checks")
    parser.add_argument("--world-option", action="append", default=[], metavar="OPTION", help="for the world")


def flights(parser: argparse.ArgumentParser) -> None:
    """The options of every program here."""
    parser.add_argument("--autopilot", nargs="+", choices=PERSONALITIES, help="by default both")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results here after every flight")
    parser.add_argument("--resume", action="store_true", help="go on where --json FILE was broken off")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the folders of the flights in this one")
    parser.add_argument("--param", action="append", default=[], metavar="NAME=VALUE", help="of the autopilot at boot")
    parser.add_argument("--list", action="store_true", help="the flights, without flying")


def ways(given: argparse.Namespace) -> Ways:
    """How the options of `common` want it flown.

    Raises:
        InputError: as `parameters`.
    """
    options = [word for option in given.world_option for word in option.split()]
    return Ways(tuple(given.skip), tuple(options), parameters(given))


def parameters(given: argparse.Namespace) -> dict[str, float]:
    """Those of the autopilot, and the folder for what is kept made.

    Raises:
        InputError: a parameter is none, or there is nothing to go on with.
    """
    if given.resume and given.json is None:
        raise InputError("--resume needs --json FILE")
    if given.keep is not None:
        given.keep.mkdir(parents=True, exist_ok=True)
    return dict(map(_parameter, given.param))


def prepare() -> None:
    """Refuse a network that others share, and end with whoever started this.

    Raises:
        InputError: it is not one of its own.
    """
    if os.environ.get(OWN_NETWORK) != "1":
        raise InputError("the autopilots listen on every interface of the computer: start this by scripts/own-network")
    end_with_parent()


def say(words: str) -> None:
    """To whoever looks on."""
    sys.stdout.write(f"{time.strftime('%H:%M:%S')} {words}\n" if words.startswith("[") else f"{words}\n")
    sys.stdout.flush()


def _parameter(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError:
        raise InputError(f"--param {text}: must be NAME=VALUE with a number") from None
