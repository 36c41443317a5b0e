"""The vehicle's side of the link: the application's end of it, and a process of its own that speaks to the ground."""
