"""The link between vehicles and the ground: what is told, what is commanded, and how the map follows."""
