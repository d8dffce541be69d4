// The posed subject seen from far away: depth only. Reads positions; clip z is linear in metres.
in vec3 in_position;  // root frame
uniform mat4 u_clip_from_root;

void main() {
    gl_Position = u_clip_from_root * vec4(in_position, 1);
}
