"""What the commands of all wings share."""
