"""The folder of a campaign: whose it is, and that what is in it is whole."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from companion.errors import InputError
from sitl.campaign import ledger
from sitl.campaign.folder import claimed
from sitl.campaign.ledger import Ledger, LedgerError
from sitl.campaign.mission import Campaign
from tests.sitl.campaign.missions import campaign


def row(mission: int, **figures: object) -> dict[str, object]:
    return {"mission": mission, "ended_because": "complete", **figures}


def test_what_was_kept_is_there_again(tmp_path: Path) -> None:
    """Protects resuming; a row that is kept again takes the place of the first, as when a failure is flown again."""
    with claimed(tmp_path / "flown", campaign(3)) as there:
        there.append(row(2, error="failed"))
        there.append(row(0, least_d_m=None))
        there.append(row(2, least_d_m=0.9))
    with claimed(tmp_path / "flown", campaign(3)) as there:
        assert there.rows == {2: row(2, least_d_m=0.9), 0: row(0, least_d_m=None)}


@pytest.mark.parametrize("cut", [1, 5, 30])
def test_a_line_that_was_cut_off_goes_away(tmp_path: Path, cut: int) -> None:
    """Protects the lines after it: a writer that was killed leaves the beginning of one, and the next is whole."""
    with Ledger(tmp_path) as there:
        there.append(row(0))
        there.append(row(1, text="of the one that is cut off"))
    there.path.write_bytes(there.path.read_bytes()[:-cut])
    with Ledger(tmp_path) as there:
        assert there.rows == {0: row(0)}
        assert json.loads(there.path.read_text(encoding="utf-8")) == row(0)
        there.append(row(1))
    with Ledger(tmp_path) as there:
        assert there.rows == {0: row(0), 1: row(1)}


@pytest.mark.parametrize("damage", [b"\0" * 20, b"[]", b'{"mission": "x"}', b'{"seed": 1}', b"\xff"])
def test_a_damaged_line_is_told(tmp_path: Path, damage: bytes) -> None:
    """Protects from a table with holes that nobody knows of: file, line, and what to do."""
    with Ledger(tmp_path) as there:
        there.append(row(0))
    there.path.write_bytes(there.path.read_bytes() + damage + b"\n")
    with pytest.raises(InputError, match=r"missions\.jsonl:2: damaged; delete this line"):
        Ledger(tmp_path)


def test_a_full_disk_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects what is there: half a line is taken away again, and there is one line of what to do."""
    with Ledger(tmp_path) as there:
        there.append(row(0))
        pwrite = ledger.os.pwrite  # type: ignore[attr-defined]
        room = [10]

        def full(file: int, data: bytes, place: int) -> int:
            if not room:
                raise OSError(28, "No space left on device")
            return int(pwrite(file, data[: room.pop()], place))

        monkeypatch.setattr("sitl.campaign.ledger.os.pwrite", full)
        with pytest.raises(LedgerError, match="No space left on device; make room"):
            there.append(row(1))
        monkeypatch.undo()
        assert json.loads(there.path.read_text(encoding="utf-8")) == row(0)
        there.append(row(2))
    with Ledger(tmp_path) as there:
        assert there.rows == {0: row(0), 2: row(2)}


def test_two_commands_do_not_fly_the_same_campaign(tmp_path: Path) -> None:
    """Protects from missions that are flown twice; the second may go on when the first has ended."""
    with claimed(tmp_path / "flown", campaign(3)) as there:
        there.append(row(0))
        with pytest.raises(InputError, match="another command is flying this campaign"):
            claimed(tmp_path / "flown", campaign(3)).__enter__()
    with claimed(tmp_path / "flown", campaign(3)) as there:
        assert set(there.rows) == {0}


def test_another_campaign_is_refused_and_what_differs_is_named(tmp_path: Path) -> None:
    """Protects the table from rows that do not belong together."""
    with claimed(tmp_path / "flown", campaign(3)) as there:
        there.append(row(0))
    other = campaign(4, "complex")
    other = Campaign(other.missions, {**other.identity, "vehicles": 2}, ())
    with pytest.raises(InputError) as refused:
        claimed(tmp_path / "flown", other).__enter__()
    assert str(refused.value).splitlines()[1:] == [
        '  worlds.room: there "stamp", here nothing',
        '  worlds.complex: there nothing, here "stamp"',
        '  seeds: there "1..3", here "1..4"',
        "  vehicles: there nothing, here 2",
    ]


def test_a_folder_in_which_nothing_was_flown_goes_away(tmp_path: Path) -> None:
    """Protects from empty folders after a mistake; one that was there, and its place, stay."""
    (tmp_path / "mine").mkdir()
    for name in ("new", "mine"):
        with pytest.raises(ZeroDivisionError), claimed(tmp_path / name, campaign(3)):
            raise ZeroDivisionError
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
    assert list((tmp_path / "mine").iterdir()) == []


def test_a_folder_of_something_else_is_left_alone(tmp_path: Path) -> None:
    """Protects what is there."""
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    for folder in (tmp_path, tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(InputError, match="--out"):
            claimed(folder, campaign(3)).__enter__()
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "campaign.json").write_text("{", encoding="utf-8")
    with pytest.raises(InputError, match=r"campaign\.json: damaged"):
        claimed(tmp_path / "damaged", campaign(3)).__enter__()


def test_the_identity_can_be_read_by_people(tmp_path: Path) -> None:
    with claimed(tmp_path / "flown", campaign(3)) as there:
        there.append(row(0))
    assert json.loads((tmp_path / "flown" / "campaign.json").read_text(encoding="utf-8")) == campaign(3).identity
