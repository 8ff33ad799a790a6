const bench = await (await fetch("api/bench")).json();
document.getElementById("state").textContent = JSON.stringify(bench, null, 2);
