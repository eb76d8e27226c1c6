"""Parsers of log files of others, which run in a child process (`hesr_model.logs.parsed_file`)."""
