"""Sinks of events: the operator's console, the pilot's ground station, the recording."""

from __future__ import annotations

import logging
from collections.abc import Callable

from companion.autopilot.status_reporter import StatusReporter
from companion.flight.events import Details, Event, Sink
from companion.mavlink.ids import MavSeverity, MavState
from companion.recording import Recorder

_LEVELS = {MavSeverity.WARNING: logging.WARNING, MavSeverity.ERROR: logging.ERROR}


def console(show: Callable[[str], None]) -> Sink:
    """A line for the operator.

    Args:
        show: prints a line.
    """

    def sink(event: Event, details: Details) -> None:
        if event.value.console is not None:
            show(event.value.console.format_map(details))

    return sink


def status_text(status_reporter: StatusReporter) -> Sink:
    """A STATUSTEXT for the pilot, and the state in our heartbeat: standby on the ground, anything else in the air."""

    def sink(event: Event, details: Details) -> None:
        texts = event.value
        if texts.status is not None:
            status_reporter.say(texts.status.format_map(details), texts.severity)
        if texts.state is not None:
            status_reporter.state(texts.state, armed=texts.state is not MavState.STANDBY)

    return sink


def recording(recorder: Recorder) -> Sink:
    """An entry in the recording's log."""

    def sink(event: Event, details: Details) -> None:
        texts = event.value
        text = texts.console if texts.recorded is None else texts.recorded
        if texts.kind and text is not None:
            recorder.event(texts.kind, text.format_map(details), _LEVELS.get(texts.severity, logging.INFO))

    return sink
