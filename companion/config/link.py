"""The link between this vehicle, the ground and other vehicles."""

from __future__ import annotations

import re
from ipaddress import ip_address
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from companion.config.section import Section, refuse

ENDPOINT_FORMS = "tcp/HOST:PORT, tls/HOST:PORT or quic/HOST:PORT, IPv6 hosts in brackets"
"""Not UDP: Zenoh repeats nothing there, and whoever lost the announcement of a topic is never told of it again."""
NAME_FORM = "1 to 32 letters, digits, - or _, the first of them a letter or digit"

_ENDPOINT = re.compile(r"(tcp|tls|quic)/(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_.-]+):([0-9]{1,5})")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}")


def _name(text: str) -> str:
    if not is_name(text):
        raise PydanticCustomError("name", NAME_FORM)
    return text


def _endpoint(text: str) -> str:
    if not is_endpoint(text):
        raise PydanticCustomError("endpoint", ENDPOINT_FORMS)
    return text


def is_endpoint(text: str) -> bool:
    """Whether a text names an endpoint."""
    match = _ENDPOINT.fullmatch(text)
    return match is not None and 0 < int(match[3]) < 65536


def is_name(text: str) -> bool:
    """Whether a vehicle or an operator may be called so: it is part of topics and of folders' names."""
    return _NAME.fullmatch(text) is not None


def is_encrypted(endpoint: str) -> bool:
    """Whether who is at the other end of an endpoint has to prove it, by a certificate."""
    return endpoint.startswith(("tls/", "quic/"))


def is_loopback(endpoint: str) -> bool:
    """Whether an endpoint can be reached from this computer only."""
    match = _ENDPOINT.fullmatch(endpoint)
    if match is None:
        return False
    return is_this_computer(match[2].strip("[]"))


def is_this_computer(host: str) -> bool:
    """Whether nobody but this computer reaches what listens there."""
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


Endpoint = Annotated[str, AfterValidator(_endpoint)]
Name = Annotated[str, AfterValidator(_name)]


class LinkSettings(Section):
    """What ground and other vehicles hear of this one, and what the ground may order. The flight does not need it."""

    enabled: bool = Field(False, description="whether there is a link to the ground and to other vehicles at all")
    name: Name = Field("vehicle", description=f"what this vehicle is called: {NAME_FORM}; each has another name")
    listen: tuple[Endpoint, ...] = Field(
        ("tcp/127.0.0.1:7447",),
        max_length=8,
        description=f"where ground and other vehicles are waited for: {ENDPOINT_FORMS}",
    )
    connect: tuple[Endpoint, ...] = Field(
        (), max_length=32, description="where the ground or other vehicles wait, likewise; tried again for ever"
    )
    certificates: str | None = Field(
        None,
        min_length=1,
        description="folder with this vehicle's certificates, as `companion keys vehicle` makes it; null: nobody has "
        "to prove who they are, on loopback only",
    )
    limit_kbps: float = Field(
        2000.0,
        ge=20.0,
        le=1e6,
        description="largest bandwidth of what is sent, in kbit/s; set it below what the radio carries",
    )
    telemetry_hz: float = Field(5.0, ge=0.2, le=20.0, description="rate of the telemetry, lower where limit_kbps asks")
    commanders: tuple[Name, ...] = Field(
        (), max_length=64, description="operators who may command; empty: each whose certificate says command"
    )
    oldest_command_s: float = Field(
        5.0, ge=0.5, le=60.0, description="a command that was given longer ago than this is refused, in s"
    )
    finish_s: float = Field(
        60.0,
        ge=0.0,
        le=3600.0,
        description="after the flight, a ground that hears it gets this long for what is missing of the map, in s",
    )

    @model_validator(mode="after")
    def _is_safe(self) -> Self:
        for key in ("listen", "connect"):
            for endpoint in getattr(self, key):
                if is_encrypted(endpoint) and self.certificates is None:
                    raise refuse(
                        f"link.{key} = {endpoint} needs link.certificates, which are not given: make them with "
                        "`companion keys`",
                        f"link.{key}",
                        "link.certificates",
                    )
                if not is_encrypted(endpoint) and not is_loopback(endpoint):
                    raise refuse(
                        f"link.{key} = {endpoint} can be reached by anybody in the network, who could command the "
                        "vehicle: use tls/ or quic/ with link.certificates; without them only loopback (127.0.0.1) is "
                        "possible",
                        f"link.{key}",
                    )
        if self.enabled and not (self.listen or self.connect):
            raise refuse(
                "link.enabled = true, but link.listen and link.connect are both empty: nobody could ever be heard; "
                f"give an endpoint: {ENDPOINT_FORMS}",
                "link.listen",
                "link.connect",
            )
        return self
