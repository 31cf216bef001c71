"""3D Tiles 1.1: a mesh or a scene as a tree of tiles that web viewers stream.

``tree`` says which tiles there are and how they nest, ``content`` cuts one out and makes its surface, ``images`` its
textures, ``place`` where it is in the world, ``write`` makes the files.
"""
