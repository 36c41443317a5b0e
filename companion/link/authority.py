"""The authority of a fleet: makes the certificates of vehicles and operators, and the list of what is revoked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Self

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from companion.config.link import is_name
from companion.config.vehicle import MOST_NUMBER
from companion.errors import InputError
from companion.link.certificates import (
    AUTHORITY_CERTIFICATE,
    AUTHORITY_KEY,
    OWN_CERTIFICATE,
    OWN_KEY,
    REVOKED,
    REVOKED_NAME,
    Role,
    common_name,
    holder,
    read_certificate,
    read_file,
    read_key,
    read_revoked,
)
from companion.mapping.files.whole import whole_file

ISSUED = "issued"

VALID_FOR = timedelta(days=3653)
VALID_FROM = datetime(1970, 1, 1, tzinfo=UTC)
"""A vehicle's computer without a battery for its clock begins here, and underground nobody tells it the time."""


class Authority:
    """The folder of an authority: its key makes certificates, so it is kept where no vehicle and no guest gets it.

    Args:
        folder: where it is.

    Raises:
        InputError: there is none, or it cannot be read.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._certificate = read_certificate(folder / AUTHORITY_CERTIFICATE)
        self._key = read_key(folder / AUTHORITY_KEY)

    @classmethod
    def make(cls, folder: Path) -> Self:
        """A new one.

        Raises:
            InputError: there is one already, or the folder cannot be written.
        """
        if (folder / AUTHORITY_KEY).exists():
            raise InputError(f"{folder}: holds an authority already; every certificate that it has made would be void")
        key = ec.generate_private_key(ec.SECP256R1())
        name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "companion link authority")])
        certificate = (
            _builder(name, name, key.public_key())
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(signs=True), critical=True)
            .sign(key, hashes.SHA256())
        )
        _write_key(folder / AUTHORITY_KEY, key)
        _write(folder / AUTHORITY_CERTIFICATE, certificate.public_bytes(serialization.Encoding.PEM))
        made = cls(folder)
        made._write_revoked({})
        return made

    def issue(self, name: str, role: Role, out: Path, number: int | None = None) -> None:
        """A certificate and its key, with all that its owner needs, in a new folder.

        Args:
            name: of its owner.
            role: what for.
            out: the folder.
            number: of a vehicle in its fleet; None: it flies alone.

        Raises:
            InputError: the name cannot be, name or number are in use, or the folder is not empty or cannot be written.
        """
        if not is_name(name):
            raise InputError(f"{name!r} is no name: 1 to 32 letters, digits, - or _, the first a letter or digit")
        if number is not None and (role != "vehicle" or not 1 <= number <= MOST_NUMBER):
            raise InputError(f"{name}, number {number}: vehicles are numbered from 1 to {MOST_NUMBER}, and nobody else")
        valid = [one for one in self.issued() if not one.is_revoked]
        if any(one.name == name for one in valid):
            raise InputError(f"{name} has a certificate already: revoke that one first, or give another name")
        for one in valid:
            if number is not None and one.number == number:
                raise InputError(f"{one.name} has the number {number} already: give another one, or revoke {one.name}")
        if out.exists() and any(out.iterdir()):
            raise InputError(f"{out}: is not empty; give a new folder")
        key, serial = ec.generate_private_key(ec.SECP256R1()), x509.random_serial_number()
        numbered = [] if number is None else [x509.NameAttribute(NameOID.SERIAL_NUMBER, str(number))]
        subject = x509.Name(
            [
                x509.NameAttribute(NameOID.COMMON_NAME, common_name(name, serial)),
                x509.NameAttribute(NameOID.ORGANIZATIONAL_UNIT_NAME, role),
                *numbered,
            ]
        )
        both = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
        certificate = (
            _builder(subject, self._certificate.subject, key.public_key(), serial)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(signs=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(both), critical=False)
            .add_extension(x509.SubjectAlternativeName([x509.DNSName(name.replace("_", "-"))]), critical=False)
            .sign(self._key, hashes.SHA256())
        )
        pem = certificate.public_bytes(serialization.Encoding.PEM)
        # On record first: nobody may have a certificate that cannot be revoked.
        _write(self._folder / ISSUED / f"{name}.{serial:x}.pem", pem)
        _write(out / OWN_CERTIFICATE, pem)
        _write_key(out / OWN_KEY, key)
        for copied in (AUTHORITY_CERTIFICATE, REVOKED):
            _write(out / copied, read_file(self._folder / copied))

    def issued(self) -> list[Issued]:
        """Every certificate that was made, in the order of the names.

        Raises:
            InputError: one cannot be read.
        """
        revoked = self._revoked()
        found = []
        for path in sorted((self._folder / ISSUED).glob("*.pem")):
            certificate = read_certificate(path)
            serial = certificate.serial_number
            found.append(Issued(*holder(certificate), serial, serial in revoked))
        return found

    def revoke(self, name: str) -> None:
        """Whoever has a certificate of this name is no longer trusted, once the list is on the vehicles.

        Raises:
            InputError: nobody has one.
        """
        serials = [one.serial for one in self.issued() if one.name == name and not one.is_revoked]
        if not serials:
            raise InputError(f"nobody called {name} has a certificate that is valid: see `companion keys list`")
        self._write_revoked(self._revoked() | dict.fromkeys(serials, name))

    def _revoked(self) -> dict[int, str]:
        return read_revoked(self._folder / REVOKED, self._certificate)

    def _write_revoked(self, revoked: Mapping[int, str]) -> None:
        now = datetime.now(UTC)
        builder = x509.CertificateRevocationListBuilder(
            self._certificate.subject, last_update=now, next_update=now + VALID_FOR
        )
        for serial, name in revoked.items():
            # Which name it was stands in the list itself: who reads it has no list of all certificates.
            named = x509.UnrecognizedExtension(REVOKED_NAME, name.encode())
            one = x509.RevokedCertificateBuilder(serial_number=serial, revocation_date=now)
            builder = builder.add_revoked_certificate(one.add_extension(named, critical=False).build())
        data = builder.sign(self._key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)
        _write(self._folder / REVOKED, data)


@dataclass(frozen=True, slots=True)
class Issued:
    """A certificate that was made: whose, for what, a vehicle's number, its serial number, whether it is revoked."""

    name: str
    role: str
    number: int | None
    serial: int
    is_revoked: bool


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, serial: int | None = None
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number() if serial is None else serial)
        .not_valid_before(VALID_FROM)
        .not_valid_after(datetime.now(UTC) + VALID_FOR)
    )


def _usage(*, signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs,
        key_cert_sign=signs,
        crl_sign=signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _write_key(path: Path, key: ec.EllipticCurvePrivateKey) -> None:
    encoding, form = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8
    _write(path, key.private_bytes(encoding, form, serialization.NoEncryption()), 0o600)


def _write(path: Path, data: bytes, mode: int = 0o644) -> None:
    """Whole or not at all, and what is secret never readable by others."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path, mode) as file:
            file.write(data)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; give a folder that you may write") from None
