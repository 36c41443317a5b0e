"""The operator's side: what is known of the vehicles at the ground, and the page that shows it."""
