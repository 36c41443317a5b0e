"""Who is trusted, and who no longer is."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

from companion.cli.main import main
from companion.errors import InputError
from companion.link.authority import Authority
from companion.link.certificates import (
    AUTHORITY_CERTIFICATE,
    OWN_CERTIFICATE,
    OWN_KEY,
    REVOKED,
    Certificates,
    signed_by,
    vehicle_certificates,
)


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    made = Authority.make(tmp_path / "authority")
    made.issue("drone1", "vehicle", tmp_path / "drone1")
    made.issue("anna", "command", tmp_path / "anna")
    return made


def test_a_signature_says_who_and_what_for(tmp_path: Path, authority: Authority) -> None:
    vehicle, anna = Certificates(tmp_path / "drone1"), Certificates(tmp_path / "anna")
    assert signed_by(anna.certificate, "stop", anna.sign("stop"), vehicle) == ("anna", "command", None)
    for pem, text, signature, why in (
        (anna.certificate, "land", anna.sign("stop"), "not that of anna"),
        (anna.certificate, "stop", vehicle.sign("stop"), "not that of anna"),
        (anna.certificate, "stop", "no hex", "not that of anna"),
        ("", "stop", "", "not signed"),
        ("nonsense", "stop", "00", "none"),
    ):
        with pytest.raises(InputError, match=why):
            signed_by(pem, text, signature, vehicle)
    assert len(authority.issued()) == 2


def test_nobody_signs_certificates_but_the_authority(tmp_path: Path, authority: Authority) -> None:
    others = Authority.make(tmp_path / "others")
    others.issue("anna", "command", tmp_path / "mallory")
    mallory = Certificates(tmp_path / "mallory")
    with pytest.raises(InputError, match="not of the authority that is trusted here"):
        signed_by(mallory.certificate, "stop", mallory.sign("stop"), Certificates(tmp_path / "drone1"))
    assert authority.issued()


def test_who_is_revoked_counts_at_once_and_a_new_certificate_of_the_same_name_is_another(
    tmp_path: Path, authority: Authority
) -> None:
    vehicle, anna = Certificates(tmp_path / "drone1"), Certificates(tmp_path / "anna")
    with pytest.raises(InputError, match="has a certificate already"):
        authority.issue("anna", "watch", tmp_path / "again")
    authority.revoke("anna")
    assert signed_by(anna.certificate, "stop", anna.sign("stop"), vehicle)[0] == "anna", "the list is not there yet"
    (tmp_path / "drone1" / REVOKED).write_bytes((tmp_path / "authority" / REVOKED).read_bytes())
    with pytest.raises(InputError, match="was revoked"):
        signed_by(anna.certificate, "stop", anna.sign("stop"), vehicle)
    authority.issue("anna", "watch", tmp_path / "again")
    again = Certificates(tmp_path / "again")
    assert signed_by(again.certificate, "stop", again.sign("stop"), vehicle) == ("anna", "watch", None)
    assert [one.is_revoked for one in authority.issued() if one.name == "anna"].count(True) == 1
    with pytest.raises(InputError, match="nobody called bob"):
        authority.revoke("bob")


def test_a_list_that_the_authority_has_not_signed_is_refused(tmp_path: Path, authority: Authority) -> None:
    """Protects from who would take a name off it."""
    Authority.make(tmp_path / "others")
    (tmp_path / "drone1" / REVOKED).write_bytes((tmp_path / "others" / REVOKED).read_bytes())
    with pytest.raises(InputError, match="has not signed it"):
        Certificates(tmp_path / "drone1")
    (tmp_path / "drone1" / REVOKED).unlink()
    with pytest.raises(InputError, match="copy it from the folder"):
        Certificates(tmp_path / "drone1")
    assert authority.issued()


def test_keys_are_for_their_owner_only(tmp_path: Path, authority: Authority) -> None:
    for key in (tmp_path / "anna" / OWN_KEY, tmp_path / "authority" / "authority.key"):
        assert stat.S_IMODE(key.stat().st_mode) == 0o600
    assert authority.issued()


@pytest.mark.parametrize("name", [AUTHORITY_CERTIFICATE, OWN_CERTIFICATE, OWN_KEY])
def test_a_folder_with_something_wrong_is_refused(tmp_path: Path, authority: Authority, name: str) -> None:
    path = tmp_path / "anna" / name
    whole = path.read_bytes()
    for content in (b"", b"nonsense", (tmp_path / "drone1" / OWN_KEY).read_bytes()):
        path.write_bytes(content)
        with pytest.raises(InputError, match=str(tmp_path)):
            Certificates(tmp_path / "anna")
    path.write_bytes(whole)
    with pytest.raises(InputError, match="is to be a vehicle"):
        vehicle_certificates(str(tmp_path / "anna"), "drone1")
    with pytest.raises(InputError, match=r"link.name = drone2"):
        vehicle_certificates(str(tmp_path / "drone1"), "drone2")
    assert vehicle_certificates(str(tmp_path / "drone1"), "drone1").name == "drone1"
    assert authority.issued()


def test_the_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def run(*words: object) -> tuple[object, str, str]:
        with pytest.raises(SystemExit) as ended:
            main(["keys", *map(str, words)])
        found = capsys.readouterr()
        return ended.value.code, found.out, found.err

    folder = tmp_path / "authority"
    assert run("authority", folder)[0] in (None, 0)
    assert "would be void" in run("authority", folder)[2], "another one in its place is refused"
    assert "link.name to drone1" in run("vehicle", "drone1", "--authority", folder, "--out", tmp_path / "v")[1]
    assert (
        "may watch and command"
        in run("operator", "anna", "--role", "command", "--authority", folder, "--out", tmp_path / "a")[1]
    )
    code, _, error = run("operator", "bob", "--authority", folder, "--out", tmp_path / "a")
    assert code == 2
    assert "not empty" in error
    assert "is no name" in run("vehicle", "../x", "--authority", folder, "--out", tmp_path / "x")[2]
    assert "is revoked: copy" in run("revoke", "anna", "--authority", folder)[1]
    lines = run("list", "--authority", folder)[1].splitlines()
    assert [line.split()[:3] for line in lines[1:]] == [["anna", "command", "revoked"], ["drone1", "vehicle", "valid"]]
    assert run("list", "--authority", tmp_path / "nowhere")[0] == 2
