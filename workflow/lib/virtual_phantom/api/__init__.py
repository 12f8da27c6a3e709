"""What `import virtual_phantom` offers: the study's steps and the diagnosis as functions, with the study's defaults."""
