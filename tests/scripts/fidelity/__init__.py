"""The parts of fidelity.py, each using only those above it:

- `volumes_in`: what is measured on: volumes with an isovalue, closed.
- `stream`: a server and one viewer of it: the surface that `done` states before a better one.
- `meshes`: how each method makes a mesh, kept in a folder.
- `measures`: distances, shading, topology, self-intersections of a mesh.
- `figures`: the tables of the page.
- `where`: a table of where on the surface a mesh is off.
- `pictures`: the pictures of the page.
"""
