"""A fleet: many robots of a few types, many days of logs."""
