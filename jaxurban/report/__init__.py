"""What is written and drawn of maps and studies."""
