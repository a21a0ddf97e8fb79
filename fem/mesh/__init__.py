"""Meshes: built, read from Gmsh, checked."""

from .checks import MeshError
from .host_mesh import HostMesh, build_mesh, read_mesh, rectangle

__all__ = ["HostMesh", "MeshError", "build_mesh", "read_mesh", "rectangle"]
