// depth_only.frag - for passes of which only the depth counts.
void main() {}
