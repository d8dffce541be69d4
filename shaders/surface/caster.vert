// One vertex of a posed surface (root frame, m) along the rays of a key light onto a floor. Writes the
// place in the light's map, and the height over the floor.
in vec3 in_position;

uniform mat4 u_clip_from_root;  // x, y of the map; z, metres over the floor, is taken as v_height

out float v_height;

void main() {
    vec4 place = u_clip_from_root * vec4(in_position, 1);
    v_height = place.z;
    gl_Position = vec4(place.xy, 0, 1);
}
