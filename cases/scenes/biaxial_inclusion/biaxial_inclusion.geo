// Specimen of the biaxial test, 0.05 m wide and 0.1 m high, with a disk of 0.008 m radius in its middle; lengths in m.
// Mesh: gmsh -2 -format msh41 biaxial_inclusion.geo
width = 0.05;
height = 0.1;
radius = 0.008;
size = 0.004;
fine = 0.0018;

Point(1) = {0, 0, 0, size};
Point(2) = {width, 0, 0, size};
Point(3) = {width, height, 0, size};
Point(4) = {0, height, 0, size};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 1};

Point(5) = {width / 2, height / 2, 0, fine};
Point(6) = {width / 2 + radius, height / 2, 0, fine};
Point(7) = {width / 2, height / 2 + radius, 0, fine};
Point(8) = {width / 2 - radius, height / 2, 0, fine};
Point(9) = {width / 2, height / 2 - radius, 0, fine};
Circle(5) = {6, 5, 7};
Circle(6) = {7, 5, 8};
Circle(7) = {8, 5, 9};
Circle(8) = {9, 5, 6};

Curve Loop(1) = {1, 2, 3, 4};
Curve Loop(2) = {5, 6, 7, 8};
Plane Surface(1) = {1, 2};
Plane Surface(2) = {2};

Physical Curve("bottom") = {1};
Physical Curve("right") = {2};
Physical Curve("top") = {3};
Physical Curve("left") = {4};
Physical Surface("matrix") = {1};
Physical Surface("inclusion") = {2};

Mesh.Algorithm = 6;
// Second order: the sides along the circle are curved.
Mesh.ElementOrder = 2;
