"""What the library is held against: peers (pyrender, embree, libigl, fast-simplification), real meshes, and
plain NumPy re-statements of what a mesh, a camera and a picture are.
Only `subjects` imports nanite_rs, to make and build the meshes under test.
"""
