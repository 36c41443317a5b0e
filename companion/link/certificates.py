"""Certificates of the link as they are read: who is a vehicle, who may watch, who may command, and who no longer may.

An authority of one's own signs them all (`companion.link.authority`); nobody else's is trusted. A certificate's common
name is the name and its serial number (``anna.3f2a``), so that one that is revoked and one that is made after it can be
told apart; its organizational unit is the role; a vehicle's serial number attribute is its number in the fleet. What is
revoked stands in a list (CRL) that the authority has signed.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, NamedTuple

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from companion.config.link import is_name
from companion.errors import InputError

Role = Literal["vehicle", "watch", "command"]

AUTHORITY_CERTIFICATE, AUTHORITY_KEY = "authority.pem", "authority.key"
OWN_CERTIFICATE, OWN_KEY = "own.pem", "own.key"
REVOKED = "revoked.crl"

REVOKED_NAME = x509.ObjectIdentifier("2.25.140417553213457790325481098123847561")
"""Of the entry in the list of what is revoked that says whose it was."""

_SIGNING = ec.ECDSA(hashes.SHA256())


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
        self.authority = read_certificate(folder / AUTHORITY_CERTIFICATE)
        self._own = read_certificate(folder / OWN_CERTIFICATE)
        self._own_key = read_key(folder / OWN_KEY)
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
            self._revoked = read_revoked(path, self.authority)
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
        raise InputError("its certificate is not of the authority that is trusted here")
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


def read_revoked(path: Path, authority: x509.Certificate) -> dict[int, str]:
    """Serial numbers of what is revoked by a list, and whose it was.

    Raises:
        InputError: there is none, or it is not the authority's.
    """
    try:
        found = x509.load_pem_x509_crl(read_file(path))
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


def read_certificate(path: Path) -> x509.Certificate:
    """The certificate in a file, PEM.

    Raises:
        InputError: there is none.
    """
    try:
        return x509.load_pem_x509_certificate(read_file(path))
    except ValueError:
        raise InputError(f"{path}: is no certificate; make it with `companion keys`") from None


def read_key(path: Path) -> ec.EllipticCurvePrivateKey:
    """The key in a file, PEM.

    Raises:
        InputError: there is none.
    """
    try:
        key = serialization.load_pem_private_key(read_file(path), None)
    except (ValueError, TypeError):
        key = None
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise InputError(f"{path}: is no key of the link; make it with `companion keys`")
    return key


def read_file(path: Path) -> bytes:
    """What is in a file.

    Raises:
        InputError: it cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; make it with `companion keys`") from None
