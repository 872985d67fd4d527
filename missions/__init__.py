"""The contract room: what every process of swarmscan agrees on. It imports no other room."""
