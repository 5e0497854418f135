"""What is believed: which suspects become causes, on flights that no fit has seen, and what remains unexplained."""
