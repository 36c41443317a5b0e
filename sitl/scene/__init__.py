"""What sensors would see of a mine: ray casting, rendering, and the truth that a map is held against."""
