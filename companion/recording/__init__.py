"""What a flight saw, decided and sent, in one MCAP file: written while flying, read for figures and for replay."""

from companion.recording.content import RECORDING_NAME, FlightInfo
from companion.recording.read import Recording, open_recording
from companion.recording.record import Recorder

__all__ = ["RECORDING_NAME", "FlightInfo", "Recorder", "Recording", "open_recording"]
