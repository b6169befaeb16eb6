"""Problem codes: stable names of problems, declared with their meanings and remedies. Standard library only."""
