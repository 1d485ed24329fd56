"""The regression of a fit: columns, rows, weights, least squares and shape parameters."""
