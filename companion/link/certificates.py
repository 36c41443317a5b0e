"""Certificates of the link: who is a vehicle, who may watch, who may command, and who no longer may.

An authority of one's own signs them all; nobody else's is trusted. A certificate's common name is the name and its
serial number (``anna.3f2a``), so that one that is revoked and one that is made after it can be told apart; its
organizational unit is the role; a vehicle's serial number attribute is its number in the fleet. What is revoked stands
in a list (CRL) that the authority has signed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Literal, NamedTuple, Self

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from companion.config.link import is_name
from companion.config.vehicle import MOST_NUMBER
from companion.errors import InputError
from companion.mapping.files.whole import whole_file

Role = Literal["vehicle", "watch", "command"]

AUTHORITY_CERTIFICATE, AUTHORITY_KEY = "authority.pem", "authority.key"
OWN_CERTIFICATE, OWN_KEY = "own.pem", "own.key"
REVOKED = "revoked.crl"
ISSUED = "issued"

REVOKED_NAME = x509.ObjectIdentifier("2.25.140417553213457790325481098123847561")
"""Of the entry in the list of what is revoked that says whose it was."""

VALID_FOR = timedelta(days=3653)
VALID_FROM = datetime(1970, 1, 1, tzinfo=UTC)
"""A vehicle's computer without a battery for its clock begins here, and underground nobody tells it the time."""

_SIGNING = ec.ECDSA(hashes.SHA256())


class Authority:
    """The folder of an authority: its key makes certificates, so it is kept where no vehicle and no guest gets it.

    Args:
        folder: where it is.

    Raises:
        InputError: there is none, or it cannot be read.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._certificate = _certificate(folder / AUTHORITY_CERTIFICATE)
        self._key = _key(folder / AUTHORITY_KEY)

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
            _write(out / copied, _read(self._folder / copied))

    def issued(self) -> list[Issued]:
        """Every certificate that was made, in the order of the names.

        Raises:
            InputError: one cannot be read.
        """
        revoked = self._revoked()
        found = []
        for path in sorted((self._folder / ISSUED).glob("*.pem")):
            certificate = _certificate(path)
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
        return _revoked(self._folder / REVOKED, self._certificate)

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


class Certificates:
    """What a vehicle or an operator was given: a folder that `Authority.issue` has made.

    Args:
        folder: where it is.

    Attributes:
        name: whose.
        role: what for.
        number: of a vehicle in its fleet; None: it has none.

    Raises:
        InputError: something is missing, or does not fit together.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.authority = _certificate(folder / AUTHORITY_CERTIFICATE)
        self._own = _certificate(folder / OWN_CERTIFICATE)
        self._own_key = _key(folder / OWN_KEY)
        self.name, self.role, self.number = holder(self._own)
        if self._own.public_key() != self._own_key.public_key():
            raise InputError(f"{folder}: {OWN_KEY} is not the key of {OWN_CERTIFICATE}; give the folder as it was made")
        if not _is_issued(self._own, self.authority):
            raise InputError(f"{folder}: {OWN_CERTIFICATE} is not of the authority of {AUTHORITY_CERTIFICATE}")
        self._revoked_at = (-1, -1)
        self._revoked: dict[int, str] = {}
        self.revoked()

    @property
    def certificate(self) -> str:
        """One's own, PEM."""
        return self._own.public_bytes(serialization.Encoding.PEM).decode()

    def revoked(self) -> dict[int, str]:
        """Serial numbers of what is revoked, and whose it was; the list is read again when it is another one.

        Raises:
            InputError: it is missing, or not the authority's.
        """
        path = self.folder / REVOKED
        try:
            state = path.stat()
        except OSError as error:
            raise InputError(f"{path}: {error.strerror}; copy it from the folder of the authority") from None
        at = (state.st_mtime_ns, state.st_size)
        if at != self._revoked_at:
            self._revoked = _revoked(path, self.authority)
            self._revoked_at = at
        return self._revoked

    @property
    def certificate_der(self) -> bytes:
        """One's own, DER: a third smaller."""
        return self._own.public_bytes(serialization.Encoding.DER)

    def sign(self, text: str) -> str:
        """A signature of a text, hexadecimal."""
        return self.sign_bytes(text.encode()).hex()

    def sign_bytes(self, data: bytes) -> bytes:
        """A signature of some bytes."""
        return self._own_key.sign(data, _SIGNING)


class Holder(NamedTuple):
    """Whom a certificate is of: the name, what for, and a vehicle's number in its fleet."""

    name: str
    role: str
    number: int | None


def vehicle_certificates(folder: str, name: str, number: int | None = None) -> Certificates:
    """Those in ``link.certificates``, which must be of this vehicle.

    Args:
        folder: where they are.
        name: of the vehicle.
        number: in its fleet; None: it flies alone, whatever number its certificate has.

    Raises:
        InputError: they are not, or cannot be used.
    """
    found = Certificates(Path(folder).expanduser())
    if (found.name, found.role) != (name, "vehicle"):
        raise InputError(
            f"link.certificates = {folder}: they are of {found.name} ({found.role}), and link.name = {name} is to be a "
            "vehicle: give its own, or make them with `companion keys vehicle`"
        )
    if number is not None and found.number != number:
        theirs = "no number" if found.number is None else f"the number {found.number}"
        raise InputError(
            f"fleet.number = {number}, but the certificate in link.certificates = {folder} gives {name} {theirs}, and "
            f"no other vehicle would believe it: make one with `companion keys vehicle {name} --number {number}`"
        )
    return found


def signed_by(pem: str, text: str, signature: str, trusted: Certificates) -> Holder:
    """Whose certificate it is that a text was signed with.

    Raises:
        InputError: nobody's that is trusted; the message says why.
    """
    try:
        proof = bytes.fromhex(signature)
    except ValueError:
        proof = b""  # nobody's
    return _signed_by(x509.load_pem_x509_certificate, pem.encode(), text.encode(), proof, trusted)


def bytes_signed_by(der: bytes, data: bytes, signature: bytes, trusted: Certificates) -> Holder:
    """As `signed_by`, of bytes and with a certificate in DER."""
    return _signed_by(x509.load_der_x509_certificate, der, data, signature, trusted)


def _signed_by(
    load: Callable[[bytes], x509.Certificate], given: bytes, data: bytes, signature: bytes, trusted: Certificates
) -> Holder:
    if not given:
        raise InputError("it is not signed")
    try:
        certificate = load(given)
        who = holder(certificate)
    except (ValueError, x509.InvalidVersion, UnsupportedAlgorithm):
        raise InputError("its certificate is none") from None
    if not _is_as_signed(certificate) or not _is_issued(certificate, trusted.authority):
        raise InputError("its certificate is not of this vehicle's authority")
    if certificate.not_valid_after_utc < datetime.now(UTC):
        raise InputError(f"the certificate of {who.name} has expired: make another")
    if certificate.serial_number in trusted.revoked():
        raise InputError(f"the certificate of {who.name} was revoked")
    key = certificate.public_key()
    try:
        if not isinstance(key, ec.EllipticCurvePublicKey):
            raise InvalidSignature
        key.verify(signature, data, _SIGNING)
    except (InvalidSignature, ValueError):
        raise InputError(f"its signature is not that of {who.name}") from None
    return who


def holder(certificate: x509.Certificate) -> Holder:
    """Whom a certificate is of.

    Raises:
        InputError: it is none of ours.
    """
    name, role, number = (
        _attribute(certificate, oid)
        for oid in (NameOID.COMMON_NAME, NameOID.ORGANIZATIONAL_UNIT_NAME, NameOID.SERIAL_NUMBER)
    )
    name = name.partition(".")[0]
    if not is_name(name) or role not in ("vehicle", "watch", "command") or not (number or "0").isdecimal():
        raise InputError("a certificate names nobody of the link: make it with `companion keys`")
    return Holder(name, role, int(number) if number else None)


def _attribute(certificate: x509.Certificate, oid: x509.ObjectIdentifier) -> str:
    found = certificate.subject.get_attributes_for_oid(oid)
    return str(found[0].value) if found else ""


def common_name(name: str, serial: int) -> str:
    """The common name in a certificate: of two with the same name one may be revoked."""
    return f"{name}.{serial % 2**32:08x}"


def _is_as_signed(certificate: x509.Certificate) -> bool:
    """Whether its signature stands at its end in whole octets: readers overlook a last 0 bit that is left out."""
    proof = certificate.signature
    der = certificate.public_bytes(serialization.Encoding.DER)
    return len(proof) < 127 and der.endswith(bytes([3, len(proof) + 1, 0]) + proof)


def _is_issued(certificate: x509.Certificate, authority: x509.Certificate) -> bool:
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature, UnsupportedAlgorithm):
        return False
    return True


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


def _revoked(path: Path, authority: x509.Certificate) -> dict[int, str]:
    try:
        found = x509.load_pem_x509_crl(_read(path))
    except ValueError:
        raise InputError(
            f"{path}: is no list of revoked certificates; copy it from the folder of the authority"
        ) from None
    key = authority.public_key()
    if not isinstance(key, ec.EllipticCurvePublicKey) or not found.is_signature_valid(key):
        raise InputError(f"{path}: the authority has not signed it; copy it from the folder of the authority")
    return {one.serial_number: _revoked_name(one) for one in found}


def _revoked_name(one: x509.RevokedCertificate) -> str:
    try:
        named = one.extensions.get_extension_for_oid(REVOKED_NAME).value
    except x509.ExtensionNotFound:
        return ""
    return named.value.decode("ascii", "replace") if isinstance(named, x509.UnrecognizedExtension) else ""


def _certificate(path: Path) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(_read(path))
    except ValueError:
        raise InputError(f"{path}: is no certificate; make it with `companion keys`") from None


def _key(path: Path) -> ec.EllipticCurvePrivateKey:
    try:
        key = serialization.load_pem_private_key(_read(path), None)
    except (ValueError, TypeError):
        key = None
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise InputError(f"{path}: is no key of the link; make it with `companion keys`")
    return key


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; make it with `companion keys`") from None


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
