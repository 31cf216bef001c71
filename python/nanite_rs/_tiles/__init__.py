"""3D Tiles 1.1: a mesh or a scene as a tree of tiles that web viewers stream.

``content`` makes the surface of a tile, ``images`` its textures, ``place`` says where it is in the world, ``write``
makes the files, and ``target`` takes them.
"""
