"""Tables of results, described once for terminal, HTML, Markdown and CSV."""
