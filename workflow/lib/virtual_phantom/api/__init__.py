"""Functions of `import virtual_phantom`: the study's steps and the diagnosis, with the study's default values."""
