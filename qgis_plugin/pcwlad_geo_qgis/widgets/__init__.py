"""What a user sees and clicks: the dock, the editor of tie points, the tools of the map."""
