"""A mission faster than real time: the vehicle, its sensors and the same navigator, without MAVLink."""
