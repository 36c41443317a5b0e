"""What people type to fly without hardware: `companion sim` and `companion sitl`."""
