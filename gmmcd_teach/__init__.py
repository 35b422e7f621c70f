"""Learn how a machine notices that a room has changed."""
