"""What is wrong or odd about data: tests of logs against themselves, a robot and a fit."""
