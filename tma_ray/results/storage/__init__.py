"""Files of a results root, on a disk or in an object store."""
