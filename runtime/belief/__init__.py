"""What is known of each place over time: evidence that a point moves, kept where it was seen."""
