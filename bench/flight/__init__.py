"""The flight: control ticks, rendering, and whole missions."""
