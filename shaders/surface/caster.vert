// One texture vertex of a posed surface along the rays of a key light onto a floor. Reads positions (root frame, m); writes the
// place in the light's map, and the height over the floor.
layout(std430, binding = 0) readonly buffer Positions { float in_position[]; };  // 3 a vertex each

in int in_vertex;

uniform mat4 u_clip_from_root;  // x, y of the map; z, metres over the floor, is taken as v_height

out float v_height;

void main() {
    int x = 3 * in_vertex;
    vec4 place = u_clip_from_root * vec4(in_position[x], in_position[x + 1], in_position[x + 2], 1);
    v_height = place.z;
    gl_Position = vec4(place.xy, 0, 1);
}
