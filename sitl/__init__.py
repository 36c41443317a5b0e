"""A mine, a vehicle and its sensors made of software, for flying `companion` without hardware."""
