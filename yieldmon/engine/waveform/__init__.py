"""What a window's samples hold beside their mean."""
