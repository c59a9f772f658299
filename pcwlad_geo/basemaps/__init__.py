"""Web maps as a reference: tiles and images of servers, of which a part is fetched into a file."""
