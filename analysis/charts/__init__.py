"""Charts: each kind of figure computed once, with a renderer for papers and one for pages."""
