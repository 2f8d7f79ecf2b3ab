const form = document.getElementById("form");
form.addEventListener("submit", async (event) => {
  event.preventDefault();
  const problem = form.querySelector(".problem");
  problem.textContent = "";
  try {
    const answer = await fetch("/sign-in", {
      method: "POST", headers: { "content-type": "application/json" },
      body: JSON.stringify({ token: new FormData(form).get("token").trim() }),
    });
    if (answer.ok) location.assign("/");
    else problem.textContent = (await answer.json()).error;
  } catch {
    problem.textContent = "The page does not answer.";
  }
});
