// A slope of 1 in 3 with level ground before and behind it; lengths in m. Make the mesh with
//   gmsh -2 -format msh41 slope.geo
SetFactory("Built-in");
Mesh.Algorithm = 6;

height = 4.0;                  // of the slope
run = 12.0;                    // of the slope, level
before = 8.0;                  // ground before the toe
behind = 12.0;                 // ground behind the crest
below = 6.0;                   // ground below the toe
fine = 0.7;
coarse = 1.6;

Point(1) = {-before, -below, 0, coarse};
Point(2) = {run + behind, -below, 0, coarse};
Point(3) = {run + behind, height, 0, coarse};
Point(4) = {run + 4.0, height, 0, fine};
Point(5) = {run + 1.0, height, 0, fine};
Point(6) = {run, height, 0, fine};
Point(7) = {0, 0, 0, fine};
Point(8) = {-before, 0, 0, coarse};

Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 5};
Line(5) = {5, 6};
Line(6) = {6, 7};
Line(7) = {7, 8};
Line(8) = {8, 1};
Curve Loop(1) = {1, 2, 3, 4, 5, 6, 7, 8};
Plane Surface(1) = {1};

Physical Curve("bottom") = {1};
Physical Curve("right") = {2};
Physical Curve("behind") = {3};
Physical Curve("load") = {4};  // 3 m, 1 m behind the crest
Physical Curve("crest") = {5};
Physical Curve("face") = {6};
Physical Curve("before") = {7};
Physical Curve("left") = {8};
Physical Surface("ground") = {1};
