"""What is done with the method: one folder for each application; none imports another."""
