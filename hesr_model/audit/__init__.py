"""What a law must be known for before it is trusted."""
