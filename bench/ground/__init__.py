"""What the operator's side costs."""
