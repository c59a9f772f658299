"""From numbers to figures to the page that people read."""
