// Where a tool's process begins.
int SPECTEX_TOOL(int argc, char** argv);

int main(int argc, char** argv) { return SPECTEX_TOOL(argc, argv); }
