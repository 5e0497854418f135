"""Python run on what is known, written down as text of another language for what is not."""
