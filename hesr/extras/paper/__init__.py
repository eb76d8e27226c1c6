"""Study of the paper: its claims, tested on the digital twin."""
