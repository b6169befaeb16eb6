// A service of a test: answers each request by a handler, and keeps the requests.

import { createServer } from "node:http";

export const DIST = "../../../clients/typescript/dist";

// `handle(request, response)` gets requests with their whole `body`; their number is in `service.requests`.
export async function serve(test, handle) {
  const requests = [];
  const server = createServer(async (request, response) => {
    const pieces = await request.toArray().catch(() => null);
    if (!pieces) return; // the client ended the request
    request.body = Buffer.concat(pieces);
    requests.push(request);
    handle(request, response, requests.length);
  });
  await new Promise((resolve) => { server.listen(0, "127.0.0.1", resolve); });
  test.after(() => { server.closeAllConnections(); server.close(); });
  return { url: `http://127.0.0.1:${server.address().port}`, requests };
}

export function answer(response, status, document, headers = {}) {
  response.writeHead(status, { "Content-Type": status < 400 ? "application/json" : "application/problem+json", ...headers });
  response.end(JSON.stringify(document));
}
