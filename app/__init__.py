"""AvatarReX Studio: the window and the command line around the `avatarrex` library."""
