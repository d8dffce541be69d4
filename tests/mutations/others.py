"""What every mutant's process needs of other packages, imported once: nothing of this project, which each has a copy of."""

import beartype
import jaxtyping
import moderngl
import numba
import PIL.Image
import scipy.ndimage
import scipy.spatial.transform
import torch
import trimesh

__all__ = ["PIL", "beartype", "jaxtyping", "moderngl", "numba", "scipy", "torch", "trimesh"]
