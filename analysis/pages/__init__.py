"""Interactive pages that need nothing but themselves."""
