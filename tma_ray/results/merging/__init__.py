"""Tables of many runs in one file each: merged, compared, read back."""
