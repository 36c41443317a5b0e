"""What is known of the mine: frontiers and completeness, distances to obstacles, and what can be seen from where."""
