"""The folder of a campaign: whose it is, what has been flown, and that it goes on where it was left."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from companion.config.source import as_yaml
from companion.errors import InputError
from companion.mapping.files.whole import whole_file
from sitl.campaign.ledger import Ledger
from sitl.campaign.mission import Campaign

IDENTITY = "campaign.json"


@contextmanager
def claimed(folder: Path, campaign: Campaign) -> Iterator[Ledger]:
    """The missions that a campaign has flown in its folder; a new folder in which none was flown goes away again.

    Raises:
        InputError: it is the folder of another campaign, or of none, or cannot be made, or another command flies it.
    """
    made = not folder.exists()
    new = _claim(folder, campaign)
    with Ledger(folder) as ledger:
        try:
            yield ledger
        finally:
            if new and not ledger.rows and {*folder.iterdir()} == {ledger.path, folder / IDENTITY}:
                ledger.path.unlink()
                (folder / IDENTITY).unlink()
                if made:
                    folder.rmdir()


def _claim(folder: Path, campaign: Campaign) -> bool:
    """Make a folder that of a campaign, and return whether it was not before."""
    file = folder / IDENTITY
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not file.exists():
            if any(not path.name.startswith(f".{IDENTITY}.") for path in folder.iterdir()):
                raise InputError(f"--out {folder}: is not empty and holds no {IDENTITY}; give a new name")
            with whole_file(file) as stream:
                stream.write((json.dumps(campaign.identity, indent=2) + "\n").encode())
            return True
        there = json.loads(file.read_text(encoding="utf-8"))
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"--out {folder}: is no folder; give a new name") from None
    except OSError as error:
        raise InputError(f"--out {folder}: {error.strerror}; give a folder that you may write") from None
    except ValueError:
        raise InputError(f"{file}: damaged; give a new folder") from None
    different = list(differences(there, json.loads(json.dumps(campaign.identity))))
    if different:
        raise InputError(
            "\n".join(
                [f"--out {folder}: holds another campaign; give a new name, or the same as there:"]
                + [f"  {line}" for line in different]
            )
        )
    return False


def differences(there: object, here: object, name: str = "") -> Iterator[str]:
    """What differs between two campaigns, one line each."""
    if isinstance(there, Mapping) and isinstance(here, Mapping):
        for key in dict.fromkeys([*there, *here]):
            inner = f"{name}.{key}" if name else str(key)
            if key not in here:
                yield f"{inner}: there {as_yaml(there[key])}, here nothing"
            elif key not in there:
                yield f"{inner}: there nothing, here {as_yaml(here[key])}"
            else:
                yield from differences(there[key], here[key], inner)
    elif there != here:
        yield f"{name}: there {as_yaml(there)}, here {as_yaml(here)}"
