"""Whether somebody was revoked, as the list in the folder of certificates says it at the moment."""

from __future__ import annotations

import logging

from companion.errors import InputError
from companion.link.certificates import Certificates

_log = logging.getLogger(__name__)


class Revocation:
    """Watches the list.

    Args:
        certificates: in whose folder it is.
    """

    def __init__(self, certificates: Certificates) -> None:
        self._certificates = certificates
        self._known = frozenset(certificates.revoked())
        self._problem = ""

    def has_changed(self) -> bool:
        """Whether it is another one than when this was last asked. One that cannot be read counts as unchanged."""
        try:
            revoked = frozenset(self._certificates.revoked())
        except InputError as error:
            if str(error) != self._problem:
                _log.warning("who is revoked is not known, and who was stays so: %s", error)
            self._problem = str(error)
            return False
        self._problem = ""
        has_changed, self._known = revoked != self._known, revoked
        return has_changed
