"""From what the sensors said to one measurement: depth images, scans and beams to h, N(t), d and d_f. Pure."""

from companion.perception.extract import Extractor

__all__ = ["Extractor"]
