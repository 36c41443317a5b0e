"""`companion map`: what a map holds, maps as files, several maps as one, and maps to look at."""
