//! Case tables of a cube, computed at start and handed to the device as constants: the marching-cubes triangles
//! ([`cases`]) and the surface sheets ([`sheets`]), over one numbering of corners, edges and faces ([`cube`]).

pub mod cases;
pub mod cube;
pub mod sheets;
