"""Estimation: equations solved, robust fits, and the precision of what shares errors; arrays only."""
