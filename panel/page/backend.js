// The page's way to a bench. All other modules use `backend` and do not know which one it is:
//
//   call(method, path, body)                 → {ok, status, body}; the body of an error has `detail`, one sentence
//   follow(drive, onUpdate, onConnection)    → stop(); onUpdate(update, whole), onConnection(true or a reason, isFinal)
//   download(format)                         → {ok, name, blob} or {ok: false, body}
//   terminal(drive, port, onText, onState)   → {send(text), close()}; onState(true, false or a reason)
//
// A static site puts its own module here, which runs the bench in WebAssembly, and has two functions more:
//
//   begin(app)                               → nothing; gives it the frame of the page
//   buttons(app, drive)                      → {node, update(news)}, a card above the drive

export { http as backend } from "./http.js";
