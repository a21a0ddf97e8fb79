// Half of a circular tunnel in two layers; lengths in m. Make the mesh with
//   gmsh -2 -format msh41 tunnel.geo
SetFactory("Built-in");
Mesh.ElementOrder = 2;         // the wall is curved
Mesh.Algorithm = 6;

radius = 2.0;
depth = 6.0;                   // of the axis
width = 16.0;                  // from the axis
bottom = -16.0;
layer = -3.0;                  // between the layers
fine = 0.35;
coarse = 1.8;

// outline and the boundary between the layers
Point(1) = {0, bottom, 0, coarse};
Point(2) = {width, bottom, 0, coarse};
Point(3) = {width, layer, 0, coarse};
Point(4) = {width, 0, 0, coarse};
Point(5) = {3.0, 0, 0, 0.6};   // end of the building
Point(6) = {0, 0, 0, 0.6};
Point(7) = {0, layer, 0, 0.5};
// tunnel
Point(10) = {0, -depth, 0, fine};
Point(11) = {0, radius - depth, 0, fine};
Point(12) = {radius, -depth, 0, fine};
Point(13) = {0, -radius - depth, 0, fine};

Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 5};
Line(5) = {5, 6};
Line(6) = {6, 7};
Line(7) = {7, 3};
Line(8) = {7, 11};
Circle(9) = {11, 10, 12};
Circle(10) = {12, 10, 13};
Line(11) = {13, 1};
Line(12) = {11, 10};
Line(13) = {10, 13};
Line(14) = {10, 12};

Curve Loop(1) = {-7, -6, -5, -4, -3};
Plane Surface(1) = {1};
Curve Loop(2) = {1, 2, -7, 8, 9, 10, 11};
Plane Surface(2) = {2};
Curve Loop(3) = {12, 14, -9};
Plane Surface(3) = {3};
Curve Loop(4) = {13, -10, -14};
Plane Surface(4) = {4};

Physical Curve("bottom") = {1};
Physical Curve("side") = {2, 3};
Physical Curve("axis") = {6, 8, 11, 12, 13};
Physical Curve("building") = {5};
Physical Curve("surface") = {4};
Physical Curve("crown_wall") = {9};
Physical Curve("bench_wall") = {10};
Physical Surface("upper") = {1};
Physical Surface("lower") = {2};
Physical Surface("crown") = {3};
Physical Surface("bench") = {4};
