"""The navigation law: its equations, its rules, and small flights in a flat world whose answers are known by hand."""
