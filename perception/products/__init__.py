"""What is made of the cloud for people to look at and measure in: mesh, texture, orthophoto, surface model."""
