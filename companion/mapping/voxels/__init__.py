"""The engine: log-odds of voxels in chunks and bricks, from depth images and planar scans."""
