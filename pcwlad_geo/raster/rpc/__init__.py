"""Images placed by rational polynomial coefficients (RPC) and the height of the ground."""
