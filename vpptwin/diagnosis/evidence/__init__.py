"""What the flights say: windows of measurements, the channels that are compared, and the twin driven through them."""
