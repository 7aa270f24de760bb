"use strict";
// Files go to the folder in pieces: the server takes no request larger than one.
const PIECE = 1 << 20;
const input = document.getElementById("file"), sent = document.getElementById("sent");
input.addEventListener("change", async () => {
  for (const file of input.files) {
    let at = 0;
    do {
      const piece = file.slice(at, at + PIECE);
      const address = `/upload/${encodeURIComponent(file.name)}?at=${at}&size=${file.size}`;
      const answer = await fetch(address, { method: "POST", body: piece });
      if (!answer.ok) {
        sent.className = "wrong";
        sent.textContent = `✕ ${(await answer.json()).error}`;
        return;
      }
      at += piece.size;
      sent.textContent = `${file.name}: ${Math.round((100 * at) / Math.max(file.size, 1))} %`;
    } while (at < file.size);
  }
  location.reload();
});
