"""What a frame is drawn with: what it shows, from where, and in which colours."""
