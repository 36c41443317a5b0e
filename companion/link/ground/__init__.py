"""The ground's side of the link: what is heard of each vehicle, a copy of its map, and commands to it."""
