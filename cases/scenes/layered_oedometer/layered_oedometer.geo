// Oedometer specimen, 0.06 m wide and 0.06 m high, with a loose layer of 0.02 m in its middle; lengths in m.
// Mesh: gmsh -2 -format msh41 layered_oedometer.geo
width = 0.06;
layer = 0.02;
size = 0.005;

For level In {0 : 3}
  Point(2 * level + 1) = {0, level * layer, 0, size};
  Point(2 * level + 2) = {width, level * layer, 0, size};
  Line(level + 1) = {2 * level + 1, 2 * level + 2};
EndFor
For level In {0 : 2}
  Line(10 + level) = {2 * level + 2, 2 * level + 4};
  Line(20 + level) = {2 * level + 1, 2 * level + 3};
  Curve Loop(level + 1) = {level + 1, 10 + level, -(level + 2), -(20 + level)};
  Plane Surface(level + 1) = {level + 1};
EndFor

Physical Curve("bottom") = {1};
Physical Curve("top") = {4};
Physical Curve("right") = {10, 11, 12};
Physical Curve("left") = {20, 21, 22};
Physical Surface("dense") = {1, 3};
Physical Surface("loose") = {2};

Mesh.Algorithm = 6;
