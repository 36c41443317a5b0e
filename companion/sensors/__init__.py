"""The world -> Measurement: what the navigation law needs to know, from what the sensors said."""

from companion.sensors.extract import Extractor

__all__ = ["Extractor"]
