"""The parts of fidelity.py and pixels.py, each using only those above it:

- `environment`: a virtual environment with what they require.
- `volumes_in`: what is measured on: volumes with an isovalue, closed.
- `stream`: a server and one viewer of it: the surface that `done` states before a better one.
- `meshes`: how each method makes a mesh, kept in a folder.
- `measures`: distances, shading, topology, self-intersections of a mesh.
- `figures`: the tables of the page.
- `where`: a table of where on the surface a mesh is off.
- `pictures`: the picture of four methods.
- `camera`: what a camera sees of a mesh, and its distance to another one in pixels.
- `camera_picture`: the picture of a cut for a camera.
"""
