"""The voxel map V: depth frames in, free, occupied and unknown space out."""

from companion.mapping.lookup import FREE, OCCUPIED, UNKNOWN
from companion.mapping.voxel_map import IntegrationReport, VoxelMap

__all__ = ["FREE", "OCCUPIED", "UNKNOWN", "IntegrationReport", "VoxelMap"]
