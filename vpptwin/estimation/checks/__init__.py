"""What a log would look like if a column were misread: units, signs, frames, ranges."""
