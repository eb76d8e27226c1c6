"""What an FMU says of itself to people: data sheet, picture, live page."""
