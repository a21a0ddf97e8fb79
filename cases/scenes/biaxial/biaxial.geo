// Rectangular specimen of the biaxial test, 0.05 m wide and 0.1 m high; lengths in m.
// Mesh: gmsh -2 -format msh41 biaxial.geo
width = 0.05;
height = 0.1;
size = 0.00252;

Point(1) = {0, 0, 0, size};
Point(2) = {width, 0, 0, size};
Point(3) = {width, height, 0, size};
Point(4) = {0, height, 0, size};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4};
Plane Surface(1) = {1};

Physical Curve("bottom") = {1};
Physical Curve("right") = {2};
Physical Curve("top") = {3};
Physical Curve("left") = {4};
Physical Surface("specimen") = {1};

// Frontal-Delaunay: nearly equilateral triangles.
Mesh.Algorithm = 6;
