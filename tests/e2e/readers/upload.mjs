// Sends files to a tus server, each over a line that may break, and prints their addresses.
import fs from "node:fs";
import path from "node:path";
import { Upload } from "tus-js-client";

const [endpoint, chunkBytes, ...files] = process.argv.slice(2);

function send(file) {
  return new Promise((resolve, reject) => {
    const upload = new Upload(fs.createReadStream(file), {
      endpoint,
      chunkSize: Number(chunkBytes),
      uploadSize: fs.statSync(file).size,
      uploadDataDuringCreation: true,
      retryDelays: Array(200).fill(300),
      metadata: { filename: path.basename(file) },
      onError: reject,
      onSuccess: () => resolve(upload.url),
    });
    upload.start();
  });
}

process.stdout.write(JSON.stringify(await Promise.all(files.map(send))));
