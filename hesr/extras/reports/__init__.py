"""Results in other formats: runs as Markdown, findings as JUnit and SARIF."""
