"""What is installed: the wheel, the versions, and what the command says about them."""
