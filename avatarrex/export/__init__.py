"""An avatar's surface as files that other programs read: GLB, VRM, USD, OBJ, PLY and a web page."""
