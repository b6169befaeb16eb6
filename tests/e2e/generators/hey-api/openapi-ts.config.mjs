export default { input: "openapi.json", output: { path: "multicap", module: { extension: ".ts" } } };
