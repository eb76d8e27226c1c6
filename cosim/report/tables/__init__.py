"""What is shown of results: each table is described once, and drawn for a terminal or a page."""
