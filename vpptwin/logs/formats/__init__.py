"""Files of many formats, taken apart into channels and tables before anything is interpreted."""
