// E of a unit normal in the root frame (fields/light.py): 1 and eight harmonics, no less than `darkest`.
vec3 light(vec3 n, vec3 harmonics[8], float darkest) {
    vec3 e = vec3(1.0) + harmonics[0] * n.x + harmonics[1] * n.y + harmonics[2] * n.z;
    e += harmonics[3] * (n.x * n.y) + harmonics[4] * (n.y * n.z) + harmonics[5] * (n.z * n.x);
    e += harmonics[6] * ((3.0 * n.z * n.z - 1.0) / 2.0) + harmonics[7] * ((n.x * n.x - n.y * n.y) / 2.0);
    return max(e, darkest);
}
