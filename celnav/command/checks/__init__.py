"""What is given to the commands, looked at before it is used; remedies for what cannot be."""
