"""``analyze``: what recorded runs were, as a table, a page and a figure."""
