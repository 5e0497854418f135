"""Files of many formats (`readers`), taken apart into channels and tables before anything is interpreted."""
