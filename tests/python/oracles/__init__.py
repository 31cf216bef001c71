"""What the library is held against: peers (pyrender, embree, libigl, fast-simplification), real meshes, and
plain NumPy re-statements of what a mesh, a camera and a picture are. Nothing here imports nanite_rs."""
