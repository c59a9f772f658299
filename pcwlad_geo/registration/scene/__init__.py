"""All tiles of a scene, matched twice: each point on its own, then guided by all of them."""
