"""The link: what it costs, how soon a stop brakes, how far the ground's map is behind."""
