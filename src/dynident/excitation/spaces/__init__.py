"""What an arm must keep clear of: distances of its shapes, and of capsules around them."""
